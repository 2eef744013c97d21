"""FlightGear as a camera: a running one is placed, asked, and photographed over its HTTP server."""
