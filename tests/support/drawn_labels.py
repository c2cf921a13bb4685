"""Where the labels of the scene are in a tab's window, read from what its graphics card is given.

viser draws all labels in one batch of rectangles (a white one behind each label's letters). Here
the numbers of that batch go through the same steps as in its vertex shader, with the camera that
three.js draws with. Nothing of that is known to `app.view.drawing.labels`, which tells the browser
only a text, a point and an anchor.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tests.support.watching import Visitor

# Of each label that is drawn: the node's name, and the rectangle [left, top, right, bottom] of its
# background in the canvas [px]. Those behind the camera are not drawn.
DRAWN = """() => {
  const { scene, camera, nodeRefFromName, nodePoseData } = window.__viserMutable;
  const canvas = document.querySelector('canvas[data-engine]');
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const apply = (m, v) => [0, 1, 2, 3].map(
    r => m[r] * v[0] + m[r + 4] * v[1] + m[r + 8] * v[2] + m[r + 12] * v[3]);
  camera.updateMatrixWorld();
  const view = camera.matrixWorldInverse.elements, lens = camera.projectionMatrix.elements;
  const nodes = window.__viserSceneTree.getState();
  const parent = nodeRefFromName['/labels'];
  const points = parent === undefined ? [] : Object.keys(nodePoseData)
    .filter(name => name.startsWith('/labels/') && nodes[name]?.effectiveVisibility)
    .map(name => [name, apply(parent.matrixWorld.elements, [...nodePoseData[name].position, 1])]);
  const drawn = [];
  scene.traverse(mesh => {
    const given = mesh.material?.uniforms, shape = mesh.geometry?.attributes;
    // Each label has one background; the letters have the atlas they are taken from.
    if (given?.uLabelData === undefined || given.uAtlas !== undefined || !shape.aRect) return;
    const data = given.uLabelData.value.image.data;
    for (let k = 0; k < mesh.geometry.instanceCount; k++) {
      const at = 4 * shape.aLabelIndex.array[k];
      const [x, y, z, visible] = data.slice(at, at + 4);
      if (!visible) continue;
      const [mode, unit] = shape.aParams.array.slice(2 * k, 2 * k + 2);
      if (mode !== 1) throw new Error('a label that is not sized by the screen');
      const eye = apply(view, [x, y, z, 1]);
      if (-eye[2] <= camera.near) continue;
      const tangent = Math.tan(camera.fov * Math.PI / 360);
      const scale = unit * (-eye[2] / 10) * tangent * (800 / height) * visible;
      const [left, bottom, wide, high] = shape.aRect.array.slice(4 * k, 4 * k + 4);
      const corner = (u, v) => {
        const clip = apply(lens, [eye[0] + scale * u, eye[1] + scale * v, eye[2], 1]);
        return [(clip[0] / clip[3] + 1) / 2 * width, (1 - clip[1] / clip[3]) / 2 * height];
      };
      const [l, b] = corner(left, bottom), [r, t] = corner(left + wide, bottom + high);
      const near = points.filter(([, p]) => Math.hypot(p[0] - x, p[1] - y, p[2] - z) < 1e-5);
      drawn.push([near.map(([name]) => name).join(' or '), [l, t, r, b]]);
    }
  });
  // The scene's axes are turned in three.js; its root knows how.
  const turn = nodeRefFromName[''].matrixWorld.elements, at = camera.position.toArray();
  const eye = [0, 1, 2].map(c => at.reduce((sum, x, r) => sum + turn[4 * c + r] * x, 0));
  return { labels: drawn, eye, width, height };
}"""


@dataclass(frozen=True)
class Drawn:
    """A label in the window: what node it may be of, its rectangle [px], y downwards, and whether
    all of that is in the picture."""

    name: str
    left: float
    top: float
    right: float
    bottom: float
    whole: bool


def drawn_labels(visitor: Visitor) -> tuple[list[Drawn], np.ndarray]:
    """All labels that are drawn in a tab and at least partly inside the picture; and from where
    the picture is taken (3,), scene units."""
    found = visitor.tab.evaluate(DRAWN)
    width, height = found["width"], found["height"]
    labels = [
        Drawn(
            name, left, top, right, bottom,
            whole=left >= 0.0 and top >= 0.0 and right <= width and bottom <= height,
        )
        for name, (left, top, right, bottom) in found["labels"]
        if right > 0.0 and bottom > 0.0 and left < width and top < height
    ]  # fmt: skip
    return labels, np.array(found["eye"])


def overlapping(labels: list[Drawn], tolerance: float = 0.05) -> list[tuple[str, str]]:
    """The pairs that share more than `tolerance` [px] in both directions."""
    return [
        (a.name, b.name)
        for a, b in combinations(labels, 2)
        if min(a.right, b.right) - max(a.left, b.left) > tolerance
        and min(a.bottom, b.bottom) - max(a.top, b.top) > tolerance
    ]
