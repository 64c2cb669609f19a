"""OpenCL C sources of the stages; read with importlib.resources."""
