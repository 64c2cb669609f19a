"""Stated and true errors of an image."""
