"""Export of policies to machines without Python: an ONNX file, and a page about it.

Nothing is written before it has decided as the policy does.
"""
