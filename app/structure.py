"""Settings of what is guarded: a structure, and how the patient was registered.

Cheap to import, see `app.options`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from app import choices
from app.kinds import Colour, File, Length, Maybe, Number, OneOf, Points, Switch, Text
from app.options import Checked, option


@dataclass(frozen=True)
class Structure(Checked):
    """A surface that is guarded with a margin of its own. Lengths are in metres.

    Attributes:
        file: a mesh file, a label map, a folder of mesh files, or a name of the catalogue. All are
            in the frame of the scene's mesh. A label may follow: ``head.nrrd:3``.
        label: number or name of a label; None: all of them.
        name: for the page; None: as the file says.
        colour: such as ``#cc8844``; None: as the file says, or the page's choice.
        opacity: of the drawing.
        margin: distance the tool keeps beyond the standoff [m]; None: as the file says, else none.
        guard: "tip" or "tool", as the option of the session; None: as that says.
        guarded: whether it is guarded; it is drawn in any case.
        unit: of the file; None: that of the scene's mesh.

    Raises:
        OptionError: an invalid value.
    """

    file: str = option(File(metavar="FILE[:LABEL]"), about="File, label map, folder or name.")
    label: str | None = option(Maybe(Text(100)), None, "Number or name of a label.")
    name: str | None = option(Maybe(Text(100)), None, "Name on the page.")
    colour: str | None = option(Maybe(Colour()), None, "Colour of the drawing.")
    opacity: float = option(Number(0.05, 1.0), 1.0, "Opacity of the drawing.")
    margin: float | None = option(
        Maybe(Length(0.0, 0.05), "default"), None, "Distance kept beyond the standoff."
    )
    guard: str | None = option(
        Maybe(OneOf("guard", choices.GUARDS), "default"), None, "What is kept out."
    )
    guarded: bool = option(Switch(), True, "Whether it is guarded.")
    unit: str | None = option(Maybe(OneOf("unit", choices.UNITS)), None, "Unit of the file.")

    def __post_init__(self) -> None:
        super().__post_init__()
        file, label = split(self.file)
        if label is not None and self.label is None:
            object.__setattr__(self, "file", file)
            object.__setattr__(self, "label", label)

    @property
    def source(self) -> tuple[str, str | None, str | None]:
        """What its surface depends on: file, label, unit."""
        return self.file, self.label, self.unit


@dataclass(frozen=True)
class Registration(Checked):
    """How the patient was registered: the guard adds to every margin what that may be off by.

    Attributes:
        fiducials: (N, 3) in the mesh's own frame [m], or a text file with x y z in mm in a line.
        fle: fiducial localisation error: r.m.s. length of the error at one fiducial [m].
        factor: the margin over the r.m.s. target registration error, see `meshes.margins`.

    Raises:
        OptionError: an invalid value. A file is read when the scene is built.
    """

    fiducials: str | tuple[tuple[float, float, float], ...] = option(
        Points(3, 1000), about="Fiducials in the mesh's own frame."
    )
    fle: float = option(Length(1e-6, 0.02), 0.35e-3, "Fiducial localisation error, r.m.s.")
    factor: float = option(
        Number(0.1, 10.0), 2.0, "Margin over the r.m.s. target registration error."
    )


def split(text: str) -> tuple[str, str | None]:
    """File and label of ``FILE:LABEL``; what ends like a file's name has no label."""
    file, colon, label = text.rpartition(":")
    if not colon or not file or not label or "/" in label or re.search(r"\.\w+$", label):
        return text, None
    return file, label


def printable(name: str) -> str:
    """A name of a file or label as one of a structure: at most 100 printable characters."""
    return "".join(c if c.isprintable() else "?" for c in name)[-100:] or "?"
