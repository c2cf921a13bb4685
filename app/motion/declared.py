"""Motions and trackers as data: each a few options, see `app.options`.

Cheap to import.
"""

from __future__ import annotations

from dataclasses import dataclass

from app.kinds import (
    SEEDS,
    Device,
    File,
    Length,
    Maybe,
    Number,
    OneOf,
    Place,
    Speed,
    Text,
    Turn,
    Whole,
)
from app.options import Checked, option
from app.words import OptionError

KINDS = ("breathing", "heartbeat", "shift", "knock", "poses", "deforming", "vertices")
FROM_FILES = ("poses", "vertices")
DEFORMING = ("deforming", "vertices")
PERIODS = {"breathing": 4.0, "heartbeat": 0.85, "shift": 300.0, "knock": 0.1}
"""Usual duration of each kind [s]: of a breath, of a beat, until a shift or knock is over."""
PREDICTORS = ("off", "periodic")


@dataclass(frozen=True)
class Motion(Checked):
    """One motion of a structure: how far it goes, and in what course of time.

    A structure may have several, which add up. Lengths are in metres, angles in radians, times in
    seconds.

    Attributes:
        kind: *breathing* rests at the end of each expiration; *heartbeat* is one
            bump a beat; *shift* goes steadily and stays; *knock* is a step and stays; *poses*
            come from a file; *deforming* is the cycle of a mesh of `meshes.deforming`;
            *vertices* come from a file or a stream.
        move: farthest displacement, along the axes of the arm's base frame [m].
        turn: farthest turn about the structure's centre, a rotation vector in the base frame [rad].
        period: of a breath, beat or cycle, or the duration of a shift or knock [s]; None: as in
            `PERIODS`, or as the mesh has it.
        after: when it begins [s].
        file: of *poses*, see `app.motion.poses`, or of *vertices*, see `app.motion.vertices`.
        stream: of *vertices* that come while the session runs, ``socket://HOST:PORT``: where the
            sandbox listens for them, see `app.devices.sockets.frames`.
        of: name of the structure that it moves; None: all of them as one, about the middle of
            the scene's mesh.
        amplitude: of *deforming*, as a share of what is usual.

    Raises:
        OptionError: an invalid value, one that is of another kind, or a kind without its file.
    """

    kind: str = option(OneOf("motion", KINDS), about="Course of the motion in time.")
    move: tuple[float, float, float] = option(
        Place(), (0.0, 0.0, 0.0), "Farthest displacement, base frame."
    )
    turn: tuple[float, float, float] = option(
        Turn(), (0.0, 0.0, 0.0), "Farthest turn about the structure's centre, base frame."
    )
    period: float | None = option(
        Maybe(Number(0.02, 1e5, "s"), "usual"), None, "Of a breath or beat; how long a step takes."
    )
    after: float = option(Number(0.0, 1e5, "s"), 0.0, "When it begins.")
    file: str | None = option(
        Maybe(File(metavar="FILE")), None, "Of poses: a table (CSV); of vertices: NumPy."
    )
    stream: str | None = option(
        Maybe(Device("stream")), None, "Of vertices that come while it runs: where to listen."
    )
    of: str | None = option(Maybe(Text(100)), None, "Name of the structure it moves; else all.")
    amplitude: float = option(Number(0.0, 3.0), 1.0, "Of deforming: share of what is usual.")

    def __post_init__(self) -> None:
        super().__post_init__()
        streamed = self.kind == "vertices" and self.stream is not None
        if self.stream is not None and not streamed:
            raise OptionError(f"the motion {self.kind} takes no stream: only vertices does")
        if streamed and self.file is not None:
            raise OptionError("the motion vertices takes a file or a stream, not both")
        if (self.kind in FROM_FILES) != (self.file is not None) and not streamed:
            wants = f"takes no file: only {' and '.join(FROM_FILES)} do"
            needs = "needs a file or a stream" if self.kind == "vertices" else "needs a file"
            raise OptionError(f"the motion {self.kind} {needs if self.file is None else wants}")
        of_others: tuple[str, ...] = ()
        if self.kind in FROM_FILES:
            of_others = ("move", "turn", "period")
        elif self.kind in DEFORMING:
            of_others = ("move", "turn")
        if self.kind != "deforming":
            of_others += ("amplitude",)
        if streamed:
            of_others += ("after",)
        for name in of_others:
            if getattr(self, name) != getattr(Motion, name):
                whose = "stream" if streamed else "file"
                said = f": its {whose} says it" if self.kind in FROM_FILES else ""
                raise OptionError(f"the motion {self.kind} takes no {name}{said}")

    @property
    def duration(self) -> float:
        """The period, or the usual one [s]."""
        return PERIODS.get(self.kind, 0.0) if self.period is None else self.period


@dataclass(frozen=True)
class Tracker(Checked):
    """What stands between a moving structure and its guard.

    Attributes:
        rate: how often the structure is seen [Hz].
        latency: from seeing to knowing [s].
        noise: r.m.s. error of a position [m]; no error is larger than three times that.
        dropouts: share of sightings that are lost.
        bound: declared: no point of the structure is ever faster [m/s]. The guard adds to the
            margin how far it can have gone since it was last seen.
        predictor: *periodic*: where the structure was a period ago, as soon as it has been seen for
            longer than that.
        period: of the predictor [s].
        stale: the tool holds while the last sighting is older than this [s].
        seed: of noise and drop-outs.
    """

    rate: float = option(Number(0.5, 2000.0, "Hz"), 30.0, "How often the structure is seen.")
    latency: float = option(Number(0.0, 2.0, "s"), 0.03, "From seeing to knowing.")
    noise: float = option(Length(0.0, 0.01), 0.0, "R.m.s. error of a position.")
    dropouts: float = option(Number(0.0, 0.95), 0.0, "Share of sightings that are lost.")
    bound: float = option(Speed(0.0, 1.0), 0.05, "Declared bound on the speed of any point.")
    predictor: str = option(OneOf("predictor", PREDICTORS), "off", "How the present is guessed.")
    period: float = option(Number(0.1, 60.0, "s"), 4.0, "Period of the predictor.")
    stale: float = option(Number(0.01, 60.0, "s"), 0.5, "Age from which the tool holds.")
    seed: int = option(Whole(*SEEDS), 0, "Of noise and drop-outs.")

    @property
    def most(self) -> float:
        """The largest margin that the guard adds: that of a sighting as old as it may be [m]."""
        return self.bound * self.stale + 3.0 * self.noise
