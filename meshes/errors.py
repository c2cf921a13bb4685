"""Errors and warnings about a mesh, one line each."""

from __future__ import annotations


class MeshError(ValueError):
    """A mesh that cannot be used: the message names the mesh, the reason and the valid choices."""


class UnitGuess(UserWarning):
    """A mesh file names no unit: the warning names the unit that is assumed, and why."""
