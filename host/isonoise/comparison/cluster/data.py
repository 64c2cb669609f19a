"""Sends the scenes and references of a comparison to the workers of a cluster, once to each; called by `runs`.

Dask keeps them on a worker as long as this process refers to them: until the worker gets those of another scene.
"""

import pickle
from functools import lru_cache

from isonoise.comparison.cluster.workers import ClusterWorkers
from isonoise.comparison.plan import SceneEntry
from isonoise.comparison.run_inputs import MAX_CACHED, RunInputs
from isonoise.distributed.packing import pack_scene

SCENE, REFERENCE = "scene", "reference"


class ClusterData:
    """What the workers have."""

    def __init__(self, inputs: RunInputs, workers: ClusterWorkers):
        self._inputs, self._client = inputs, workers.cluster.client
        # workers of this machine get bytes faster than zlib makes them fewer
        self.is_compressed = workers.cluster.size is None
        self._sent: dict[tuple[str, str], tuple[SceneEntry, object]] = {}  # worker, kind -> scene, Dask's future
        self._packed = lru_cache(2 * MAX_CACHED)(self._pack)

    def missing(self, worker: str, scene: SceneEntry, *kinds: str) -> dict[str, bytes]:
        """What has to be sent to the worker, for `send`."""
        return {kind: self._packed(scene, kind) for kind in kinds if not self._is_there(worker, kind, scene)}

    def _is_there(self, worker: str, kind: str, scene: SceneEntry) -> bool:
        """After an interrupted connection Dask has dropped what was sent."""
        sent, future = self._sent.get((worker, kind), (None, None))
        return sent == scene and future.status == "finished"

    async def send(self, worker: str, scene: SceneEntry, missing: dict[str, bytes]) -> None:
        """In the thread of Dask's client."""
        for kind, data in missing.items():
            future = await self._client.scatter(data, workers=[worker], hash=False)
            self._sent[worker, kind] = (scene, future)

    def on_worker(self, worker: str, kind: str) -> object:
        """Dask's future of what was sent: an argument of a function that is submitted to this worker."""
        return self._sent[worker, kind][1]

    def forget(self, worker: str) -> None:
        """The worker is gone, and what it had."""
        for kind in (SCENE, REFERENCE):
            self._sent.pop((worker, kind), None)

    def _pack(self, scene: SceneEntry, kind: str) -> bytes:
        if kind == SCENE:
            return pack_scene(self._inputs.scene(scene), self.is_compressed)
        return pickle.dumps(self._inputs.reference(scene))
