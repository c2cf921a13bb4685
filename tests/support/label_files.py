"""Label maps of known shapes, written by the formats' own descriptions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from tests.support import volume_files as files

NAMES = {1: "Left kidney", 2: "sheet", 5: "tube", 9: "drop"}
COLOURS = {1: (200, 30, 40), 2: (0, 255, 0), 5: (17, 34, 51), 9: (250, 250, 5)}
SHAPE = (30, 26, 22)
BOXES = {
    1: (slice(3, 13), slice(4, 12), slice(3, 15)),
    2: (slice(16, 26), slice(5, 6), slice(4, 16)),  # one voxel thin
    5: (slice(6, 22), slice(20, 21), slice(8, 9)),  # one voxel thin in two directions
    9: (slice(27, 28), slice(20, 21), slice(18, 19)),
}
LABELS = np.zeros(SHAPE, dtype=np.uint8)
for _label, _box in BOXES.items():
    LABELS[_box] = _label
T_MM = files.affine(files.TURN @ np.diag([0.8, 1.0, -1.25]), SHAPE)


def slicer_keys(segments: list[tuple[int, int, str, tuple[int, int, int]]]) -> str:
    """The header of a 3D Slicer segmentation: layer, value, name and colour of each segment."""
    lines = []
    for k, (layer, value, name, colour) in enumerate(segments):
        share = " ".join(f"{one / 255:.6f}" for one in colour)
        lines += [
            f"Segment{k}_Color:={share}", f"Segment{k}_Extent:=0 9 0 9 0 9",
            f"Segment{k}_ID:=Segment_{k + 1}", f"Segment{k}_LabelValue:={value}",
            f"Segment{k}_Layer:={layer}", f"Segment{k}_Name:={name}",
        ]  # fmt: skip
    return "".join(f"{line}\n" for line in lines)


def write_seg_nrrd(path: Path) -> Path:
    """LABELS as 3D Slicer writes them: LPS, one layer, names and colours."""
    segments = [(0, k, NAMES[k], COLOURS[k]) for k in NAMES]
    return files.write_nrrd(path, LABELS, T_MM, extra=slicer_keys(segments))


def write_pngs(folder: Path, kind: str) -> Path:
    """LABELS as pictures, slice by slice: "P" with a palette, "L" grey values, "RGB" colours."""
    folder.mkdir()
    for k in range(SHAPE[2]):
        rows = LABELS[:, :, k].T
        if kind == "RGB":
            colours = np.zeros((256, 3), dtype=np.uint8)
            for label, colour in COLOURS.items():
                colours[label] = colour
            picture = Image.fromarray(colours[rows])
        else:
            picture = Image.fromarray(rows)
            if kind == "P":
                palette = [0] * 768
                for label, colour in COLOURS.items():
                    palette[3 * label : 3 * label + 3] = colour
                picture.putpalette(palette)
        picture.save(folder / f"slice{k}.png")  # slice10 after slice9
    return folder


CTBL = "# Color table file /somewhere.ctbl\n" + "".join(
    f"{k} {name.replace(' ', '_')} {' '.join(map(str, COLOURS[k]))} 255\n"
    for k, name in {0: "background", **NAMES}.items()
    if k
)
FREESURFER = "#$Id: FreeSurferColorLUT.txt\n\n#No. Label Name:   R   G   B   A\n" + "".join(
    f"{k:<4}  {name.replace(' ', '_'):30} {COLOURS[k][0]:4}{COLOURS[k][1]:4}{COLOURS[k][2]:4}   0\n"
    for k, name in NAMES.items()
)
SNAP = (
    "################\n# ITK-SnAP Label Description File\n"
    "# IDX   -R-  -G-  -B-  -A--  VIS MSH  LABEL\n"
    '    0     0    0    0        0  0  0    "Clear Label"\n'
    + "".join(
        f'{k:5}  {COLOURS[k][0]:4} {COLOURS[k][1]:4} {COLOURS[k][2]:4}        1  1  1    "{name}"\n'
        for k, name in NAMES.items()
    )
)
