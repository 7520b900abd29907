"""Export of policies to machines without Python: an ONNX file, and a page about it.

A file is written only if its decisions equal the policy's.
"""
