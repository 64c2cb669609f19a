"""Writes scene descriptions as Mitsuba 3 XML, with meshes and images in files beside it."""
