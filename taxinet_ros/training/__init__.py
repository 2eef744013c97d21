"""Training of the network on rendered scenes, and measuring how well it sees."""
