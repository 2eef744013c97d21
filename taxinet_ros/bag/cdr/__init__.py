"""Bytes of messages: decoded, compared, and filled into templates."""
