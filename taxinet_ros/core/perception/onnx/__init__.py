"""Third-party networks in ONNX files, checked before use."""
