"""Measurements of the view between two read-outs."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from app.control.messages import Telemetry
from app.scene.moment import Moment
from app.settings import Options
from app.view.tabs.depth import Whereabouts, whereabouts
from app.view.tabs.readouts import Extras
from app.view.tabs.rows import Motion


def fixture_names(options: Options) -> tuple[str, ...]:
    """Names of the structures that are guarded, in the order of the controller's fixtures."""
    return tuple(str(own.name) for own in options.anatomy if own.guarded)


class Measuring:
    """Called from the view thread, once per read-out."""

    def __init__(self) -> None:
        self._newest: Telemetry | None = None
        self._newest_since = time.monotonic()
        self._count = 0
        self._before: Telemetry | None = None  # at the last read-out
        self._tip_before: NDArray[np.float64] | None = None

    def measure(self, shown: Moment, unwatched: int, ended: str) -> Extras:
        """Measure one moment; `unwatched` and `ended` as in `Extras`."""
        scene, telemetry = shown.scene, shown.telemetry
        step = telemetry.step
        in_sphere, speed = 0, 0.0
        where: Whereabouts | None = None
        if step is not None and telemetry.scene == scene.version:
            p_tip = np.array(step.tip.translation)
            reach = step.radius + shown.options.tip_radius
            options = shown.options
            placed = shown.guarded or shown.structures[:1]
            in_sphere = sum(
                len(one.surface.within(one.seen(p_tip), reach).triangles) for one in placed
            )
            where = whereabouts(
                scene, telemetry.q, p_tip, options.tip_radius, shown.crossing,
                options.trocar if options.guards_tool else 0.0,
                [(str(one.own.name), one.surface) for one in placed],
                [one.pose for one in placed],
            )  # fmt: skip
            before = self._before
            if before is not None and self._tip_before is not None:
                elapsed = telemetry.time - before.time
                if elapsed > 0.0 and before.scene == telemetry.scene:
                    speed = float(np.linalg.norm(p_tip - self._tip_before)) / elapsed
            self._before, self._tip_before = telemetry, p_tip
        now = time.monotonic()
        if telemetry is not self._newest:  # a paused loop, too, sends new telemetry
            self._newest, self._newest_since = telemetry, now
        self._count += 1
        joints = tuple(scene.arm.joints)
        silent = now - self._newest_since
        parts = tuple(capsule.name for capsule in scene.arm.capsules)
        structures = fixture_names(shown.options) if scene.structures else ()
        return Extras(
            in_sphere, speed, joints, silent, self._count, where, unwatched, ended, parts,
            structures, _motion(shown), _stream(shown),
        )  # fmt: skip


def _stream(shown: Moment) -> str:
    """Where vertices come from, and what is wrong; empty: they do not come from elsewhere."""
    link = shown.stream
    if link is None:
        return ""
    return f"{link.url} ({link.trouble})" if link.trouble else link.url


def _motion(shown: Moment) -> Motion | None:
    """The read-outs of structures that move; None: none does."""
    if not shown.moves:
        return None
    beliefs = [belief for belief in shown.places.beliefs if belief is not None]
    age = max((belief.age for belief in beliefs), default=0.0)
    return Motion(shown.contacts, bool(beliefs), shown.places.margin, age)
