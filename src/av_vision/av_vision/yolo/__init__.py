"""Detection with YOLO models in ONNX format; boxes are in pixels of the image."""
