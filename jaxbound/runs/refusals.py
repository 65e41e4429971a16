"""What ends a run before it is done: what was given cannot be used, or somebody stops it."""

__all__ = ["Interrupted", "Refused", "Stopped"]


class Refused(ValueError):
    """What the user gave cannot be used; the message says why."""


class Stopped(KeyboardInterrupt):
    """A signal asks for the end, as Ctrl-C does."""


class Interrupted(KeyboardInterrupt):
    """The user stopped it; the message says what is left and how to go on."""
