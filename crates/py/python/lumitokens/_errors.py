"""Exceptions of the package: all are `LumiError`, and the built-in kind that fits them."""


class LumiError(Exception):
    """Anything that the package refuses or fails at."""

    __module__ = "lumitokens"


class FileError(LumiError, OSError):
    """A file or folder could not be read or written."""

    __module__ = "lumitokens"


class FormatError(LumiError, ValueError):
    """A file was read, but something in it is not as it must be; the message names file and field."""

    __module__ = "lumitokens"


class InputError(LumiError, ValueError):
    """An argument is out of its range; the message names it and what was expected."""

    __module__ = "lumitokens"


class ModelError(LumiError):
    """Weights or a model's config do not fit."""

    __module__ = "lumitokens"


class UnsupportedError(LumiError):
    """The model was asked for what it was not made or trained for."""

    __module__ = "lumitokens"


class LumiWarning(UserWarning):
    """Something that a reader had to assume or leave out."""

    __module__ = "lumitokens"
