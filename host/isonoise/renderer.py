"""A render in progress: a scene on a device, and the strategy that distributes the samples wave by wave."""

from __future__ import annotations  # `help` shows the names of types

import contextlib
import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from isonoise.argument_checks import check_integer, check_seed
from isonoise.device.opencl import Device
from isonoise.device.selection import select_devices
from isonoise.error.distribution import ErrorDistribution
from isonoise.error.stated_error import error_distribution
from isonoise.errors import UserError
from isonoise.render_devices import RenderDevices
from isonoise.renderer_options import check_options
from isonoise.renderer_set_up import Hooks, set_up_device, set_up_workers
from isonoise.scene.files import record_files
from isonoise.scene.load_compiled import SceneSource, bvh_builder, load_compiled, source_name
from isonoise.scene.view import NO_VIEW, View
from isonoise.signals import raise_if_received
from isonoise.state.settings import check_settings, render_settings
from isonoise.state.state import State
from isonoise.statistics import Statistics
from isonoise.strategies import DEFAULT_STRATEGY, Strategy, make_strategy
from isonoise.strategies.reset import StrategyReset
from isonoise.wave import WaveRecord
from isonoise.wave_tracer import WaveTracer

if TYPE_CHECKING:
    from isonoise.distributed.cluster import Cluster
    from isonoise.distributed.distributed_wavefront import DistributedWavefront
    from isonoise.integrator.wavefront import Wavefront

MAX_WAVE_SAMPLES = 2**62
MIN_REMAINING_PIXEL_SAMPLES = 2**20
"""A render ends when a pixel can take fewer samples than this: its 32-bit count is nearly full."""


class Renderer(RenderDevices):
    """Renders a scene wave by wave. `close`, or the end of a `with` block, frees the device and ends the workers.

    Parameters
    ----------
    scene : str, path, dict, Scene or CompiledScene
        A scene or mesh file, the name of a built-in scene, a dict in Mitsuba 3's vocabulary, or what `isonoise.load`,
        `Scene.compile` or `compile_scene` returns.
    device : str, int or None
        Number or part of the name of an OpenCL device. None: the first of `isonoise devices`. `all`, `0,1` and `0/2`
        are several devices, or parts of one (`isonoise.device.selection.select_devices`).
    strategy : str or Strategy
        `NAME[:key=value,...]`, `module:Class[:key=value,...]`, or an object.
    seed : int
        0 to 2^64 - 1. The same seed gives the same samples.
    size : (width, height) or None
        Image size in pixels. None: the scene's.
    max_depth : int or None
        Longest path in segments: 1 is emitters only, -1 has no limit. None: the scene's.
    parameters : dict or None
        Values for the `$name` placeholders of an XML scene.
    sampler : str or None
        `sobol`: well-distributed samples; `independent`: independent ones. None: the scene's.
    pool_size : int or None
        Paths in flight, 1 to 2^25. None: the device's default (`isonoise.device.pool_size`). Affects speed only, not
        the image.
    profile : bool
        Measure `device_seconds`.
    allow_outside : bool
        Whether the files that a scene file names may be outside its folder (`isonoise.load`).
    memory : int or None
        Most bytes that the render may take: buffers on the device; if the device shares the host's memory, as a CPU
        does, with the arrays of the image on the host. The pool is made smaller until they fit.
    view : View or None
        Camera and environment in place of the scene's own.
    cluster : Cluster or None
        Workers that trace the samples in place of `device` (`isonoise.distributed.cluster.Cluster`). This process
        computes the statistics on its default device. It stays open when the renderer is closed.
    layers : sequence of str
        Layers beside the colour, such as `albedo` and `depth`, of `isonoise.layers.LAYERS`. They change no sample.
    on_compile : callable or None
        Called before each kernel program is compiled, with the renderer, whose scene and device are known by then, the
        program's name, how many programs are done, and how many there are; and once before all of them, with '', 0, 0.

    Attributes
    ----------
    scene : CompiledScene
        The scene as arrays.
    files : tuple of Path
        Every file that the scene was read from, with symbolic links resolved: scene file, includes, meshes, images.
    strategy : Strategy
        The strategy in use.
    device_name : str
        Name of the OpenCL device and its platform, of several devices, or of the cluster.
    driver : str
        Version of its driver, and the CPU that the driver's compiler emits code for, if that is known.
    seed : int
        The seed in use.
    layer_names : tuple of str
        The layers that `layers` returns.
    needs : Needs
        Statistics that the device keeps: those of the strategy, the sampler and the layers.
    setup_times : dict of str to float
        Seconds to `load` the scene, `build` its BVH and `compile` the kernels.

    Raises
    ------
    UserError
        If a parameter is wrong; SceneError if the scene is, DeviceError if the device is missing or has too little
        memory.

    Examples
    --------
    >>> renderer = isonoise.Renderer("cornell", size=(64, 48))
    >>> for wave in range(3):
    ...     record = renderer.step()
    >>> record.kind, round(renderer.statistics().samples / (64 * 48), 1)
    ('uniform', 18.7)
    """

    def __init__(
        self,
        scene: SceneSource,
        device: str | int | None = None,
        strategy: str | Strategy = DEFAULT_STRATEGY,
        seed: int = 0,
        size: tuple[int, int] | None = None,
        max_depth: int | None = None,
        parameters: Mapping[str, object] | None = None,
        sampler: str | None = None,
        pool_size: int | None = None,
        profile: bool = False,
        allow_outside: bool = False,
        memory: int | None = None,
        view: View | None = None,
        cluster: Cluster | None = None,
        layers: Sequence[str] = (),
        on_compile: Callable[[Renderer, str, int, int], None] | None = None,
    ):
        options = check_options(locals())  # all arguments by name
        seed, size, max_depth = options["seed"], options["size"], options["max_depth"]
        pool_size, memory = options["pool_size"], options["memory"]
        self.strategy, self.seed = make_strategy(strategy), seed
        self.source_name = source_name(scene)
        self.parameters = {name: str(value) for name, value in (parameters or {}).items()}
        self.overrides = {"size": size, "max_depth": max_depth, "sampler": sampler, "parameters": self.parameters}
        self.overrides["view"] = asdict(view or NO_VIEW)
        self.layer_names: tuple[str, ...] = options["layers"] or ()
        if self.layer_names:
            from isonoise.film.layers import check_host_layers  # a render without layers does not need it

            check_host_layers(self.layer_names, self.strategy)
        self.device_name: str  # set with the device
        self.driver: str
        self.setup_times: dict[str, float] = {}
        with self._measured("load"), record_files() as files:
            keep_uvs = "uv" in self.layer_names
            self.scene = load_compiled(scene, self.parameters, allow_outside, view, size, max_depth, sampler, keep_uvs)
        self.files: tuple[Path, ...] = tuple(files)
        self.needs = needs = self.strategy.needs.with_sampler(self.scene.sampler).with_layers(self.layer_names)
        settings = (self.scene, needs, seed, pool_size, memory, self.strategy.is_adaptive)

        def report(program: str, done: int, total: int) -> None:
            if on_compile is not None:
                on_compile(self, program, done, total)

        def on_device(name: str, driver: str) -> None:
            self.device_name, self.driver = name, driver
            report("", 0, 0)

        hooks: Hooks = {"measured": self._measured, "on_device": on_device, "on_compile": report}
        selected = [] if cluster else select_devices(device)
        self._distributed = None
        wavefront: Wavefront | DistributedWavefront
        if len(selected) == 1:
            wavefront = set_up_device(Device(selected[0], profile), *settings, build_bvh=bvh_builder(scene), **hooks)
        else:
            wavefront = self._distributed = set_up_workers(selected, cluster, *settings, **hooks)
        self._strategy_reset = StrategyReset(self.strategy)
        self._open_waves = WaveTracer(wavefront, self.strategy, self.scene, needs.uniform)

    def __iter__(self) -> Iterator[WaveRecord]:
        """Render wave after wave, until the caller stops or `is_full`: `step` before every record.

        Examples
        --------
        >>> with isonoise.Renderer("cornell", size=(32, 32)) as renderer:
        ...     for wave in renderer:
        ...         if wave.statistics.samples >= 16 * 32 * 32:
        ...             break
        >>> wave.number, renderer.samples
        (1, 16384)
        """
        while not self.is_full:
            yield self.step()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def reset(self, seed: int | None = None) -> None:
        """Forget all samples and begin anew, with the kernels and buffers that are there: nothing is compiled.

        The image is that of a new renderer, bit by bit. The strategy, too, is as it was at first. Records and
        statistics that were read stay.

        Parameters
        ----------
        seed : int or None
            0 to 2^64 - 1. None: the same seed, so the same samples, as before.

        Raises
        ------
        UserError
            If the seed is out of range, or the strategy keeps something that cannot be copied, such as an open file.

        Examples
        --------
        >>> means = []
        >>> with isonoise.Renderer("cornell", size=(32, 32)) as renderer:
        ...     for seed in range(3):
        ...         renderer.reset(seed)
        ...         means.append(renderer.step().statistics.mean.mean())
        >>> len(set(means))
        3
        """
        seed = self.seed if seed is None else check_seed(seed)
        waves = self._waves
        self._strategy_reset(self.strategy)
        waves.statistics.forget()
        waves.wavefront.reset(seed)
        self.seed = seed
        self._open_waves = WaveTracer(waves.wavefront, self.strategy, self.scene, waves.statistics.uniform is not None)
        vars(self).pop("settings", None)  # which have the seed

    @contextlib.contextmanager
    def _measured(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        raise_if_received()
        self.setup_times[name] = time.perf_counter() - start

    @property
    def remaining_pixel_samples(self) -> int:
        """Samples that one pixel can still take: the device counts them in 32 bits."""
        return self._waves.planner.remaining_pixel_samples

    @property
    def is_full(self) -> bool:
        """Whether a pixel's 32-bit sample count is nearly full, so that a render has to end."""
        return self.remaining_pixel_samples < MIN_REMAINING_PIXEL_SAMPLES

    def step(self, samples: int | None = None, should_continue: Callable[[int], bool] | None = None) -> WaveRecord:
        """Render the strategy's next wave, or the rest of one that has begun.

        Parameters
        ----------
        samples : int or None
            Upper limit for the samples of the wave. The rest of a uniform wave comes with the next step; the rest of an
            adaptive one is dropped.
        should_continue : callable or None
            Called with the wave's samples that have entered the statistics: before every slice, and after every bounce
            while paths are left to start. Once it returns False no new paths start; those in flight are finished and
            counted.

        Returns
        -------
        WaveRecord

        Raises
        ------
        UserError
            If the strategy returns an invalid wave or allocation map.
        """
        if self.wave_kind is None:
            self.begin_wave(samples)
        self.continue_wave(should_continue)
        return self.end_wave()

    @property
    def wave_kind(self) -> Literal["uniform", "adaptive"] | None:
        """'uniform' or 'adaptive' during a wave, else None."""
        return self._waves.wave_kind

    def begin_wave(self, samples: int | None = None) -> None:
        """Plan the strategy's next wave, of at most `samples`, for `continue_wave`. Raises UserError as `step` does."""
        limit = None if samples is None else check_integer("samples", samples, 0, MAX_WAVE_SAMPLES)
        self._waves.begin_wave(limit)

    def continue_wave(self, should_continue: Callable[[int], bool] | None = None) -> bool:
        """Trace samples of the wave until `should_continue`, as in `step`, returns False; whether all are traced."""
        return self._waves.continue_wave(should_continue)

    def end_wave(self) -> WaveRecord:
        """End the wave. The rest of it, if there is one, is dropped."""
        return self._waves.end_wave(1 if self._distributed is None else self._distributed.count_active_workers())

    @functools.cached_property
    def settings(self) -> dict[str, object]:
        """What the image depends on, as plain values: the settings of a `State`."""
        return render_settings(self)

    def state(self, reuse: State | None = None) -> State:
        """Return all that the render is, also in the middle of a wave. Waits for the device.

        Parameters
        ----------
        reuse : State or None
            An earlier state of this render, whose arrays may be overwritten: new memory takes longer than the copy.

        Raises
        ------
        DeviceError
            If the device has lost samples, so that the render cannot be continued.
        UserError
            If the strategy keeps something that cannot be stored.
        """
        return self._waves.state(self.settings, reuse)

    def restore(self, state: State) -> None:
        """Continue from a state of a render with the same settings. Only for a renderer that has not rendered yet.

        Raises
        ------
        UserError
            If the settings differ; the message names the difference.
        """
        if "renderer" not in state.values:
            raise UserError("a merged render cannot be continued; render the scene with another seed, and merge both")
        check_settings(state.settings, self.settings)
        try:
            self._waves.restore(state)
        except (LookupError, TypeError, ValueError, AttributeError, StopIteration) as error:  # also of the strategy
            raise UserError(f"the render cannot be continued: its state is damaged ({error!r})") from error

    def statistics(self) -> Statistics:
        """Return the statistics of all samples so far, in the scene's units. Waits for the device."""
        return self._waves.statistics.read()

    def error_distribution(self, floor: float) -> ErrorDistribution:
        """The distribution of the pixels' relative errors |x - r| / max(r, floor), r the true image.

        Its quantiles are those of `isonoise.error.stated_error.stated_error`, to 0.4 %. Waits for the device.
        """
        statistics = self.statistics()  # which the device reads
        if not floor > 0:
            return error_distribution(statistics, floor)
        self._wavefront.accumulator.update_luminance()
        return self._wavefront.errors.distribution(floor * self.scene.radiance_scale)

    def layers(self) -> Mapping[str, np.ndarray]:
        """Return the layers that were asked for, of all samples so far, by name. Waits for the device.

        Arrays are (height, width) float32, or (height, width, channels).
        """
        if not self.layer_names:
            return {}
        from isonoise.film.layers import make_layers

        return make_layers(self.layer_names, self._wavefront.accumulator.layers(), self.statistics(), self.strategy)

    def image(self) -> np.ndarray:
        """Return the mean linear RGB, (height, width, 3) float32. Waits for the device."""
        return self._waves.statistics.read_rgb()
