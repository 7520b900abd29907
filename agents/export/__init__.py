"""Export of policies to machines without Python: an ONNX file, and a page about it.

Every export is first compared with the policy.
"""
