"""The version of this package, the same as package.xml has."""

__version__ = '0.1.0'
