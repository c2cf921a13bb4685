"""What the page shows: the running session, or a replay in its place."""

from __future__ import annotations

from collections.abc import Callable

from app.recording.playback import Moment
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
        self.shown = self.now()

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
            )
        return self.shown
