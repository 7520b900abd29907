"""Agents for machines without Python: an ONNX file, a C header, and a page that says what goes in
and out; each decides as the policy does, which is checked before it is written.
"""
