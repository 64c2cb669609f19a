"""Errors that the user can fix: the command line prints their message without a traceback and exits with 2."""


class UserError(Exception):
    """The user's input is wrong. The message says what is wrong, where, and what to do."""


class SceneError(UserError):
    """A scene is wrong or outside the supported subset. The message names file, element and remedy."""


class DeviceError(UserError):
    """There is no usable OpenCL device, or it lacks memory. The message says what to install or change."""
