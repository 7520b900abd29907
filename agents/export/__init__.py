"""Export of policies to machines without Python: an ONNX file, a C header, and a page about both.

Nothing is written before it has decided as the policy does.
"""
