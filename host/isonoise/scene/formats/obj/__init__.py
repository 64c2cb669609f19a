"""Reads OBJ and MTL files into scene dicts."""
