"""What the page shows: the running session, or a replay in its place."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from app.control.messages import Telemetry
from app.motion.movement import Movement
from app.scene.moment import Moment, Places, places_at
from app.scene.scene import Scene
from app.session import Session


class Source:
    """Scene, options and telemetry for all parts of the page.

    Attributes:
        override: returns what to show instead of the session; None: the session is shown.
        caption: text of the banner while `override` is set.
        shown: the last result of `now`.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.override: Callable[[], Moment] | None = None
        self.caption = ""
        self._movement: tuple[Scene, Movement] | None = None
        self._moving = threading.Lock()  # several threads ask
        self.shown = self.now()

    def moment(self, telemetry: Telemetry) -> Moment:
        """A past tick of the session's present scene."""
        session, step = self._session, telemetry.step
        scene = session.scene
        force = np.zeros(3) if step is None else step.force
        places = self._places(scene, telemetry)
        return Moment(scene, session.options, telemetry, False, force, places=places)

    @property
    def live(self) -> bool:
        """Whether the session itself is shown."""
        return self.override is None

    def now(self) -> Moment:
        """The newest state to show."""
        override = self.override  # another thread may clear it
        if override is not None:
            self.shown = override()
        else:
            session = self._session
            # Telemetry is read first, so that the scene is not older than the tick.
            telemetry = session.latest()
            scene, master, crossing = session.scene, session.master, session.crossing
            by_script = telemetry.autopilot and telemetry.target is not None
            self.shown = Moment(
                scene,
                session.options,
                telemetry,
                master.clutched,
                master.force,
                telemetry.target if by_script else master.handle,
                crossing if crossing is not None and crossing.scene == scene.version else None,
                self._places(scene, telemetry),
                session.contacts,
                session.stream,
            )
        return self.shown

    def _places(self, scene: Scene, telemetry: Telemetry) -> Places:
        """Where the structures are; before the scene's first tick where they rest."""
        with self._moving:
            if self._movement is None or self._movement[0] is not scene:
                self._movement = scene, Movement(scene.courses, scene.options.tracker)
            phase = telemetry.phase if telemetry.scene == scene.version else 0.0
            return places_at(self._movement[1], phase)
