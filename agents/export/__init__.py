"""Export of policies to machines without Python: an ONNX file, and a page about it.

Files are written only if the ONNX graph decides as the policy does, except in ties (`check.py`).
"""
