"""The version of the package: here alone, the wheel and the documentation read it from this file."""

__all__ = ["__version__"]

__version__ = "0.1.0"
