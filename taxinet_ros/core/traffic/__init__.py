"""Others on the ground: aircraft, vehicles, cones, people, and marks on the pavement."""
