"""Memory and work-group size of kernels, as the driver reports them. Called by `measure`."""

from isonoise.device.drivers import load_pyopencl
from isonoise.device.opencl import Device


def kernel_memory(device: Device, kernel) -> dict[str, int | None]:
    """Bytes of private memory per work-item and of local memory per work-group, and the preferred work-group multiple.

    None where the driver does not say. PoCL reports 1024 bytes of private memory for every kernel, whatever it uses,
    which counts as not saying.
    """
    cl = load_pyopencl()

    def ask(name: str) -> int | None:
        try:
            return int(kernel.get_work_group_info(getattr(cl.kernel_work_group_info, name), device.device))
        except cl.Error:
            return None

    return {
        "private_memory_bytes": None if device.is_pocl else ask("PRIVATE_MEM_SIZE"),
        "local_memory_bytes": ask("LOCAL_MEM_SIZE"),
        "preferred_work_group_multiple": ask("PREFERRED_WORK_GROUP_SIZE_MULTIPLE"),
    }
