"""What can go wrong with a mesh, told in one line."""

from __future__ import annotations


class MeshError(ValueError):
    """A mesh that cannot be used: the message names the mesh, the reason and the valid choices."""


class UnitGuess(UserWarning):
    """A mesh file says nothing about its unit: the warning tells what is taken for it, and why."""
