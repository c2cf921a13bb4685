"""The operating state of the guard as a CRTK arm: what is accepted in it, and what is refused."""

from __future__ import annotations

from enum import StrEnum


class State(StrEnum):
    """The four states of a CRTK robot."""

    DISABLED = "DISABLED"  # no set-point goes to the arm
    ENABLED = "ENABLED"
    PAUSED = "PAUSED"  # the arm holds
    FAULT = "FAULT"  # no set-point goes to the arm until it was disabled and enabled again


COMMANDS = ("enable", "disable", "pause", "resume", "home", "unhome")
_NEXT = {
    (State.DISABLED, "enable"): State.ENABLED,
    (State.ENABLED, "enable"): State.ENABLED,
    (State.ENABLED, "pause"): State.PAUSED,
    (State.PAUSED, "pause"): State.PAUSED,
    (State.PAUSED, "resume"): State.ENABLED,
}


class Machine:
    """The operating state. Whatever is refused leaves it as it is.

    Attributes:
        state: the state.
        homed: whether the arm knows its joints.
        why: of a FAULT; empty else.
    """

    def __init__(self, homed: bool = True) -> None:
        self.state = State.DISABLED
        self.homed = homed
        self.why = ""

    def command(self, word: str, there: bool = True) -> str:
        """Obey a `state_command`; returns why it is refused, or nothing.

        Args:
            there: whether the arm's joints are known: without them nothing is enabled.
        """
        if word not in COMMANDS:
            return f"unknown state command {word[:40]!r}: choose one of {', '.join(COMMANDS)}"
        if word == "disable":
            self.state, self.why = State.DISABLED, ""
            return ""
        if word in ("home", "unhome"):
            if self.state is not State.ENABLED:
                return f"{word} is not supported in state {self.state}: enable the arm first"
            self.homed = word == "home"
            return ""
        if (self.state, word) not in _NEXT:
            more = f" ({self.why}): disable it first" if self.state is State.FAULT else ""
            return f"{word} is not supported in state {self.state}{more}"
        if word == "enable" and not there:
            return "the arm is not heard of: it cannot be enabled"
        self.state = _NEXT[self.state, word]
        return ""

    def fail(self, why: str) -> None:
        """Enter FAULT, and say why."""
        self.state, self.why = State.FAULT, why

    def refuses(self) -> str:
        """Why a motion is refused now, or nothing."""
        if self.state is not State.ENABLED:
            return f"the arm is {self.state}"
        return "" if self.homed else "the arm is not homed"
