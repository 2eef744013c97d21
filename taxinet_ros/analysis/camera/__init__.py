"""Pictures of the camera: contact sheets, and our frames beside real ones."""
