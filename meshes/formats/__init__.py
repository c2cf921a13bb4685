"""Readers of mesh files, one module a format; `meshes.load` chooses among them."""
