"""Examples of clusters in host/README.md: their syntax, their options, and renders with stand-ins for ssh and srun."""

import ast
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from isonoise.cli import make_parser
from isonoise.film.exr import read_exr

README = Path(__file__).resolve().parent.parent / "host" / "README.md"
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", README.read_text("utf-8"), re.DOTALL)
SHELL = [body for language, body in BLOCKS if language == "sh"]
SSH, SBATCH, KUBECTL = SHELL


def commands(script: str, *start: str) -> list[list[str]]:
    """Words of each command of a script that begins with `start`, wherever in a line."""
    found = []
    for line in script.replace("\\\n", " ").splitlines():
        words = shlex.split(line.rstrip(" &"))
        found += [words[k:] for k in range(len(words)) if tuple(words[k : k + len(start)]) == start]
    return found


def example(language: str) -> str:
    (body,) = (body for name, body in BLOCKS if name == language)
    return body


@pytest.mark.skipif(not shutil.which("bash"), reason="no bash")
@pytest.mark.parametrize("script", SHELL, ids=["ssh", "sbatch", "kubectl"])
def test_shell_syntax(script):
    subprocess.run(["bash", "-n"], input=script, text=True, check=True)


def test_options_of_isonoise():
    for script in SHELL:
        for command in commands(script, "isonoise", "render"):
            assert make_parser().parse_args(command[1:]).dask == command[command.index("--dask") + 1]


def dask_options(tool: str) -> set[str]:
    command = pytest.importorskip(f"distributed.cli.dask_{tool}", reason="no Dask").main
    return {option for parameter in command.params for option in parameter.opts}


def test_options_of_dask():
    """Those of the examples, and those that the text names."""
    workers = [command for script in (SSH, SBATCH) for command in commands(script, "dask", "worker")]
    (from_yaml,) = re.findall(r"\[dask, worker, (.*)\]", example("yaml"))
    workers.append(from_yaml.replace('"', "").split(", "))
    (from_python,) = re.findall(r"worker_extra_args=(\[.*\])", example("python"))
    workers.append(["--nworkers", "1", "--nthreads", "1", *ast.literal_eval(from_python)])
    assert len(workers) == 4
    for command in workers:
        assert {word for word in command if word.startswith("--")} <= dask_options("worker")
        for option, value in ("--nworkers", "1"), ("--nthreads", "1"), ("--memory-limit", "0"):
            assert command[command.index(option) + 1] == value
    schedulers = [command for script in (SSH, SBATCH) for command in commands(script, "dask", "scheduler")]
    assert len(schedulers) == 2
    for command in schedulers:
        assert {word for word in command if word.startswith("--")} <= dask_options("scheduler")
    options = {"--dashboard-address", "--tls-ca-file", "--tls-cert", "--tls-key"}
    assert options <= dask_options("worker") & dask_options("scheduler")
    assert "--death-timeout" in dask_options("worker")


def test_workers_take_the_cpus_of_their_task():
    for script in SBATCH, example("python"):
        assert "export POCL_MAX_PTHREAD_COUNT=$SLURM_CPUS_PER_TASK" in script
    cpus, limit = re.search(
        r'POCL_MAX_PTHREAD_COUNT, value: "(\d+)".*cpu: "(\d+)"', example("yaml"), re.DOTALL
    ).groups()
    assert cpus == limit


def test_variables_of_dask():
    pytest.importorskip("distributed", reason="no Dask")
    from dask.config import collect_env, get

    names = (
        "DASK_DISTRIBUTED__COMM__TLS__CA_FILE",
        "DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT",
        "DASK_DISTRIBUTED__COMM__TLS__CLIENT__KEY",
    )
    tls = collect_env(dict.fromkeys(names, "file.pem"))["distributed"]["comm"]["tls"]
    known = get("distributed.comm.tls")
    assert tls.keys() <= {key.replace("-", "_") for key in known}
    assert tls["client"].keys() <= known["client"].keys()


def test_options_of_jobqueue():
    (block,) = (node for node in ast.parse(example("python")).body if isinstance(node, ast.With))
    names = {keyword.arg for keyword in block.items[0].context_expr.keywords}
    jobqueue = pytest.importorskip("dask_jobqueue", reason="no dask-jobqueue")
    documented = set(re.findall(r"^    (\w+) : ", jobqueue.SLURMCluster.__doc__, re.MULTILINE))
    assert names <= documented


def test_kubernetes():
    yaml = pytest.importorskip("yaml", reason="no PyYAML")
    cluster = yaml.safe_load(example("yaml"))
    (scheduler,) = cluster["spec"]["scheduler"]["spec"]["containers"]
    service = cluster["spec"]["scheduler"]["service"]
    name = cluster["metadata"]["name"]
    # labels of the scheduler's pod and the name of its service are made by the operator of dask-kubernetes
    assert service["selector"] == {"dask.org/cluster-name": name, "dask.org/component": "scheduler"}
    assert f"service/{name}-scheduler 8786" in KUBECTL
    ports = {port["name"]: port["containerPort"] for port in scheduler["ports"]}
    assert ports == {port["targetPort"]: port["port"] for port in service["ports"]}
    assert ports["tcp-comm"] == 8786


def write_commands(folder: Path, **scripts: str) -> str:
    """Executable shell scripts in a folder; returns a PATH that begins with it."""
    folder.mkdir()
    for name, body in scripts.items():
        path = folder / name
        path.write_text(f"#!/bin/sh\n{body}\n")
        path.chmod(0o755)
    return f"{folder}{os.pathsep}{os.environ['PATH']}"


def run_example(script: str, **options) -> None:
    """Run a script in a process group of its own, which is ended if a process is left."""
    process = subprocess.Popen(["bash", "-c", script], stderr=subprocess.PIPE, text=True, **options)
    try:
        stderr = process.communicate(timeout=300)[1]  # until the last process that writes to it has ended
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 0, stderr


def channels(path: Path) -> dict[str, np.ndarray]:
    return read_exr(path)[0]


@pytest.mark.long
@pytest.mark.skipif(not shutil.which("bash"), reason="no bash")
@pytest.mark.parametrize("script", [SSH, SBATCH], ids=["ssh", "sbatch"])
def test_examples_render(script, tmp_path):
    """With stand-ins for ssh and srun that start workers on this machine: the bits of a render without a cluster."""
    pytest.importorskip("distributed", reason="no Dask")
    python = shlex.quote(sys.executable)
    path = write_commands(
        tmp_path / "bin",
        dask=f'exec {python} -m dask "$@"',
        isonoise=f'command=$1; shift; exec {python} -m isonoise $command "$@" --size 96x64',
        hostname="echo 127.0.0.1",
        ssh='[ "$1" = -n ] && shift 2 && exec "$@"',
        srun='shift; for k in $(seq $SLURM_NTASKS); do "$@" & ids="$ids $!"; done; trap "kill $ids" TERM; wait',
    )
    slurm = {"SLURM_JOB_ID": str(os.getpid()), "SLURM_NTASKS": "2", "SLURM_CPUS_PER_TASK": "1"}
    environment = os.environ | slurm | {"PATH": path, "HOST": "127.0.0.1"}
    run_example(script, cwd=tmp_path, env=environment, start_new_session=True)
    (render,) = commands(script, "isonoise", "render")
    options = ["render", "cornell", "--spp", render[render.index("--spp") + 1], "--size", "96x64"]
    subprocess.run([sys.executable, "-m", "isonoise", *options, "-o", "one.exr"], cwd=tmp_path, check=True, timeout=300)
    one, several = channels(tmp_path / "one.exr"), channels(tmp_path / "cornell.exr")
    assert one.keys() == several.keys()
    for name, channel in one.items():
        assert channel.tobytes() == several[name].tobytes(), name
