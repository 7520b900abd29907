"""The sweep: how controllers do where one thing at a time is otherwise than agents were trained."""
