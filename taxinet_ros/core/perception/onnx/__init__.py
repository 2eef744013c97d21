"""Networks in ONNX files, looked at before they are trusted."""
