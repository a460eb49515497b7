"""Exceptions of the package. Their texts are those of the command line."""


class UpswingError(Exception):
    """A computation failed."""


class InputError(UpswingError, ValueError):
    """An argument, a file or a setting cannot be used: what, where, what is expected, what it is."""


class NoPlan(UpswingError):
    """No plan keeps all limits: the reason for each database entry that was tried, and for the full optimisation."""


class Aborted(UpswingError):
    """A run in closed loop did not begin: no plan, or one that the controller refuses."""
