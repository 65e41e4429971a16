"""The method "joint": exact tests of windows whose first state lies in what the samples before them allow."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from jaxbound.estimation.counts import is_whole
from jaxbound.estimation.method import ObserverMethod, ShellOption

if TYPE_CHECKING:
    from jaxbound.estimation.set_observer import ObserverSetup, SetObserver

__all__ = ["Joint"]

WINDOW, SHORTEST, LONGEST = 32, 4, 1000


@dataclass(frozen=True)
class Joint(ObserverMethod):
    """Test every window of up to `window` samples exactly, beside zonotopes.

    Fields: window: samples, even and at least 4.

    Raises:
        ValueError: another window.
    """

    window: int = WINDOW

    name: ClassVar[str] = "joint"
    about: ClassVar[str] = "exact tests of windows that remember: slow faults, some hundred times slower"
    sharp: ClassVar[bool] = True
    shell: ClassVar[tuple[ShellOption, ...]] = (
        ShellOption("window", "--span", WINDOW, SHORTEST, LONGEST, "samples of such a window, even"),
    )

    def __post_init__(self) -> None:
        if not is_whole(self.window) or self.window < SHORTEST or self.window % 2:
            raise ValueError(f"window must be an even number of samples >= 4, not {self.window!r}")

    def observer(self, setup: "ObserverSetup") -> "SetObserver[Any]":
        """Return the observer of this method."""
        from jaxbound.estimation.joint_observer import joint_observer

        return joint_observer(setup, int(self.window))
