"""OpenCL: devices, programs and their cache, buffers, launches."""
