"""The skull cap with what is inside it: what is cut, and what must not be."""

from __future__ import annotations

from collections.abc import Mapping

from meshes.builtin import skull
from meshes.builtin.temporal_bone import Member

NAME = "craniotomy"

_MEMBERS = (
    Member("bone", (227, 218, 201), None, skull.skull),
    Member("inner surface", (200, 120, 150), 0.0, skull.endocranium),
)


def members() -> Mapping[str, Member]:
    """The structures by name, the bone first; both in the skull's axes."""
    return {one.name: one for one in _MEMBERS}
