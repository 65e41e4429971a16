"""The options of one way to observe, as a frozen value, and their words for the command line.

A method is one small class here and in the files beside it; `methods` is the table of them. These files
import nothing heavy: a command line builds its options from them before anything is computed.
"""

import html
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

if TYPE_CHECKING:
    from jaxbound.estimation.set_observer import ObserverSetup, SetObserver

__all__ = ["ObserverMethod", "ShellOption"]


class ShellOption(NamedTuple):
    """An option of a method on the command line, a whole number.

    Fields: field: its name in the method's value; flag: its name on the command line; default, least, most:
    of its value; help: one line, without the default.
    """

    field: str
    flag: str
    default: int
    least: int
    most: int
    help: str

    @property
    def dest(self) -> str:
        """The name that argparse gives the option's value."""
        return self.flag.strip("-").replace("-", "_")


class ObserverMethod(ABC):
    """A way to observe: options that are checked when they are given, and the observer that they make.

    A new method is a frozen dataclass of this kind, in a file that imports nothing heavy, and one line of
    `methods.OBSERVERS`. Its fields are its options.

    name: of `observer(model, method=name)` and of the command line. about: a few words for the help.
    sharp: whether it tests windows of samples together, which sees smaller faults than zonotopes do.
    shell: its options on the command line.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    sharp: ClassVar[bool] = False
    shell: ClassVar[tuple[ShellOption, ...]] = ()

    def _repr_html_(self) -> str:
        return f"<code>{html.escape(repr(self))}</code>"

    @abstractmethod
    def observer(self, setup: "ObserverSetup") -> "SetObserver[Any]":
        """Return the observer of this method."""
