"""Mesh file formats as plain numpy, one module each; no trimesh in here.

`mesh_io` chooses among them and turns what they return into meshes. They read faces themselves because
face counts, vertex order, numbers of 64 bits and values per vertex must survive exactly, and a polygon or a
truncated file must be noticed, never repaired in silence.
"""
