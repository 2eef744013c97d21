"""What moves the aircraft: flight dynamics, gusts and the steering law."""
