"""What the page shows: the session as it runs, or something put in its place."""

from __future__ import annotations

from collections.abc import Callable

from app.recording.playback import Moment
from app.session import Session


class Screen:
    """The one place from which the page takes scene, options and telemetry.

    Attributes:
        instead: what to show instead of the session; None: the session.
        caption: what the banner says meanwhile.
        shown: what `now` returned last.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.instead: Callable[[], Moment] | None = None
        self.caption = ""
        self.shown = self.now()

    @property
    def live(self) -> bool:
        """Whether the session itself is shown."""
        return self.instead is None

    def now(self) -> Moment:
        """What to show now."""
        instead = self.instead
        if instead is not None:
            self.shown = instead()
        else:
            session = self._session
            # Telemetry first: what it refers to is in force by then, or will be.
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
