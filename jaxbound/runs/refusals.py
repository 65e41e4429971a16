"""Exceptions that end a run before it is done: the user gave something unusable, or stopped it."""


class Refused(ValueError):
    """The refusal of what a user gave; the message says why."""


class Stopped(KeyboardInterrupt):
    """A signal asks for the end, as Ctrl-C does."""


class Interrupted(KeyboardInterrupt):
    """The user stopped it; the message says what is left and how to go on."""
