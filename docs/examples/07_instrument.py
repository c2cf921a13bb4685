"""The bodies of an arm's instrument: capsules around axes that its joints move.

Every arm has them (`arm.capsules`, the one at the tip first). A needle can be put on the
free-flying tip, and an arm of your own gives its own (`robots.Capsule`); one that gives none is its
tip.
"""

import numpy as np

import robots
from robots import point

for arm in (*map(robots.load, robots.names()), point.load(needle=(0.02, 0.0, 0.04))):
    print(f"{arm.name}, {len(arm.joints)} joints")
    axes = arm.axes(arm.neutral)  # (c, 2, 3): where each axis starts and ends, base frame
    for capsule, (start, end) in zip(arm.capsules, axes, strict=True):
        length = np.linalg.norm(end - start)
        print(
            f"  {capsule.name:11} radius {capsule.radius * 1e3:5.2f} mm, "
            f"axis {length * 1e3:5.1f} mm, moves with {' and '.join(dict.fromkeys(capsule.frames))}"
        )
