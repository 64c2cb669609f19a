"""Built-in scenes; read with importlib.resources."""
