"""Training and evaluation of the network on rendered scenes."""
