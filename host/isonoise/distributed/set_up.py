"""Sets up renders on several devices of this machine, or on a cluster. Called by `Renderer`."""

from collections import Counter
from collections.abc import Sequence

from isonoise.device.drivers import describe_driver
from isonoise.device.opencl import Device
from isonoise.device.precompile import OnCompile
from isonoise.device.selection import SelectedDevice
from isonoise.distributed.cluster import Cluster
from isonoise.distributed.device_pool import DevicePool
from isonoise.distributed.distributed_wavefront import DistributedWavefront, plan_client_memory
from isonoise.distributed.shard_tracer import ShardTracer
from isonoise.integrator.memory_plan import PROCESS_BYTES
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import Needs


def describe_workers(selected: Sequence[SelectedDevice], cluster: Cluster | None) -> tuple[str, str]:
    """Names of the devices, or of the cluster, and versions of their drivers."""
    if cluster:
        return cluster.name, "drivers of the workers"
    names = Counter((each.whole_name, each.parts > 1) for each in selected)
    texts = (
        f"{number} parts of {name}" if is_part else f"{number} x {name}" if number > 1 else name
        for (name, is_part), number in names.items()
    )
    drivers = dict.fromkeys(describe_driver(each.device) for each in selected)
    return ", ".join(texts), "; ".join(drivers)


def make_distributed_wavefront(
    selected: Sequence[SelectedDevice],
    cluster: Cluster | None,
    scene: CompiledScene,
    needs: Needs,
    seed: int,
    pool_size: int | None,
    memory: int | None,
    is_adaptive: bool,
    on_compile: OnCompile,
) -> DistributedWavefront:
    """A wavefront on several devices, or on the workers of a cluster. Other arguments as for `ShardTracer`.

    The first device also computes the statistics, while no wave is traced: the whole of it, if a part is selected. With
    a cluster the default device of this process does.
    """
    client = Device(selected[0].number if selected else None)
    if cluster:
        pool = cluster.pool(scene, needs, pool_size, memory)
    else:
        memory_each = memory
        if memory is not None and client.shares_memory:
            left = memory - plan_client_memory(client, scene, needs, is_adaptive).shared
            memory_each = max(left // len(selected), 0) + PROCESS_BYTES  # the plan of each device counts the process
        pool = _device_pool(selected, scene, needs, pool_size, memory_each, on_compile)
    try:
        return DistributedWavefront(client, scene, needs, pool, seed, memory, is_adaptive, on_compile)
    except BaseException:
        pool.close()
        raise


def _device_pool(selected, scene, needs, pool_size, memory, on_compile) -> DevicePool:
    """A pool of tracers that share the BVH of the scene."""
    bvh = build_scene_bvh(scene)

    def make_tracer(device: Device, on_compile: OnCompile) -> ShardTracer:
        return ShardTracer(device, scene, needs, pool_size, memory, bvh, on_compile)

    return DevicePool([Device(each) for each in selected], make_tracer, on_compile)
