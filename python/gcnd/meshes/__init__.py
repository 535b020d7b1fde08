"""Every kind of mesh that gcnd takes, one file a library: apart into arrays, and together again with moved vertices.

A library is imported by nobody but the holder of one of its objects: `adapter_for` goes by the names of classes.
"""
