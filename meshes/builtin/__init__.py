"""Meshes that come with the package or with others: the catalogue, its shapes, and damage."""
