"""Messages from core values and back."""
