"""The texts below the options in `isonoise COMMAND --help`. `cli` imports this only when such a help is printed."""

from isonoise.errors import UserError
from isonoise.tables import label_lines


def render_epilog() -> str:
    """Strategies with their parameters, and the columns of the log."""
    from isonoise.film.log import columns
    from isonoise.strategies import DEFAULT_STRATEGY, available_strategies, describe, make_strategy
    from isonoise.strategies.lookup import MEASURES, RULES

    lines = [f"strategies (default: {DEFAULT_STRATEGY}) with their parameters' defaults:"]
    for name in available_strategies():
        try:
            lines.append(f"  {describe(make_strategy(name))}")
        except UserError as error:  # a parameter is required, or an installed package's strategy fails to load
            lines.append(f"  {name}: {error}")
    lines.append("  module:Class for your own")
    lines.append("  measures: " + ", ".join([*MEASURES.names(), "module:function for your own"]))
    lines.append("  rules: " + ", ".join([*RULES.names(), "module:function for your own"]) + "\n")
    lines.append("columns of --log (those with the prefix true_ only with --reference):")
    lines.append(label_lines(columns(true_errors=True).items(), indent="  ", wrap=110))
    lines += [
        "",
        "exit codes: 0 done; 1 --error not reached within the other limits; 2 bad input, or a file could not be",
    ]
    lines.append("written; 70 internal error; 130 after Ctrl-C; 143 after SIGTERM; 129 after SIGHUP")
    return "\n".join(lines)


def compare_epilog() -> str:
    """Additional strategies, presets, metrics, and the files that a comparison writes."""
    from isonoise.comparison.presets import PRESETS
    from isonoise.comparison.table_columns import METRICS

    metrics = [f"  {name:<24} {meaning}" for name, meaning in METRICS.items()]
    presets = []
    for name, preset in PRESETS.items():
        presets.append(f"  {name}: {preset.description}")
        budget = f"{preset.time:g} s" if preset.time else f"{', '.join(f'{n:g}' for n in preset.spp)} samples per pixel"
        presets.append(f"    {preset.seeds} seeds, {budget} per run; scenes {', '.join(preset.scenes)};")
        presets += [f"    {spec}" for spec in preset.strategies]
    return f"""\
strategies in addition to those of `isonoise render`:
  NAME:sampler=S           any of them with the sampler S of `isonoise render --help`, sobol if it is not named
  oracle                   without file=: reads variances from long uniform runs, made once per scene
  mitsuba-independent      Mitsuba 3 with its sampler `independent`; needs the extra `peers`
  mitsuba-multijitter      the same with `multijitter`; DRJIT_LIBLLVM_PATH may have to name the libLLVM to use.
                           Its strata are those of one pass, so a run is one pass of all samples

presets:
{chr(10).join(presets)}

metrics:
{chr(10).join(metrics)}

files in DIR:
  report.html              tables and plots in one file
  summary.json             the tables' numbers
  tables.md                the tables as Markdown
  runs.csv, runs.parquet   one row per run; Parquet with the extra `tables`. Columns: host/docs/comparison-tables.md
  waves.csv, waves.parquet one row per wave of every run
  summary.csv, .parquet    one row per scene and strategy
  images/SCENE/STRATEGY/SEED.exr   with --keep-images the final image of a run: R, G, B as 16-bit floats
  flip.json                with the metric flip its values, so that they are computed once
  plots/                   the plots as PNG, SVG and PDF files, the maps as PNG files
  references/SCENE.exr     rendered references: R, G, B and standard errors stderr.R, .G, .B
  runs/SCENE/STRATEGY/SEED.npz   one finished run; delete it to render it again
  plan.json                the comparison's settings, and hashes of what determines the images
  environment.json         versions of packages, system, device and driver that have rendered
  experiment.toml          copy of the experiment's file; its keys: host/docs/experiments.md
  .lock                    the process that is writing, until it ends; a second one is refused

Runs and references have a SHA-256 and say what they are. Those that are damaged, of something else, or measured against
another reference are rendered again first, and a warning names them.

exit codes: 0 done; 2 bad input, or DIR holds another comparison or is in use; 70 internal error; 128 + n after signal
n, such as 130 after Ctrl-C"""


def bench_epilog() -> str:
    """Generated scenes, and what --against, --peers, --specialisation and --versus measure."""
    from isonoise.benchmark.generated_scenes import GENERATED_SCENES
    from isonoise.commands.bench import DEFAULT_SCENES

    return f"""\
scenes in addition to files and built-in ones: {", ".join(GENERATED_SCENES)}, meshes of that many triangles under
an environment map. They are generated; `python -m isonoise.benchmark.generated_scenes NAME FOLDER` writes one.
Without SCENE: {", ".join(DEFAULT_SCENES)}; with --peers also mesh-1.3m; with --specialisation the
built-in scenes.

A run has about 2 million samples on a CPU and 16 million on a GPU unless --spp is given.

--against compares samples/s and every kernel's time by their medians. It ignores kernels with at most 5 % of the
time, and differences if the repeats' ranges overlap. Device, scene, size, depth and samples have to be the same;
the driver may differ.

--peers measures in turn with Mitsuba 3 (llvm_ad_rgb, path) on the same file, size, depth and Russian roulette.
For scenes of triangles only, also with Embree on one thread on the same rays: the camera's, and those after one
diffuse bounce. It needs the extra `peers`; DRJIT_LIBLLVM_PATH may have to name a libLLVM, 19 or newer.

--specialisation measures in turn with kernels that support more than the scene uses: `all-path` has all features
of the integrator path, `all-volpath` also those of volpath. It compares the images, too. Compilation times are
measured in separate processes, about a minute per scene on a CPU.

--versus keeps a process for each side, which traces the same number of samples in turn with the other, so that a
busy machine slows down both. The ratio is the median over the pairs of runs. The other checkout needs no
installation and may be an older version. This side is slower if the median is below --threshold and every pair
below 1.

--dump takes longer with PoCL, which compiles every kernel once more if asked for its binary.

exit codes: 0 done; 1 --against or --versus found something slower; 2 bad input; 70 internal
error; 130 after Ctrl-C"""
