"""From a CT or MR volume, or a label map, to a surface.

World coordinates are RAS (x to the patient's right, y to the front, z up), whichever way the file
holds them, so that the same patient lies the same way; where a file does not say how the patient
lies, `Volume.frame` is None and `Volume.notes` says so. Files are in millimetres; what comes out
is in metres.
"""

from meshes.volume.files import FORMATS, read
from meshes.volume.grid import MOST_BYTES, MOST_VOXELS, Volume
from meshes.volume.labels import MIDDLE, one_label, told
from meshes.volume.surfaces import MOST_TRIANGLES, surface

__all__ = [
    "FORMATS",
    "MIDDLE",
    "MOST_BYTES",
    "MOST_TRIANGLES",
    "MOST_VOXELS",
    "Volume",
    "one_label",
    "read",
    "surface",
    "told",
]
