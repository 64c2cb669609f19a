"""Kernel texts: flattened, specialised by features, with records that host and device lay out alike.

Preprocessing is done by the system's `cpp` where there is one; tests that need it are skipped elsewhere.
"""

import re
import shutil
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from feature_sets import all_but, only

from isonoise.device import program
from isonoise.device.form import FORMS
from isonoise.device.opencl import Device
from isonoise.device.program import declare_struct, flatten, stage_source
from isonoise.errors import DeviceError
from isonoise.integrator.build_constants import build_constants
from isonoise.integrator.features import FEATURES
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import BRUTE_FORCE_KERNELS, KERNELS, STRUCTS
from isonoise.renderer import Renderer
from isonoise.statistics import Needs

FOLDER = Path(str(resources.files("isonoise.kernels")))
FILES = sorted(str(file.relative_to(FOLDER)) for file in FOLDER.rglob("*") if file.suffix in (".cl", ".h"))
STAGES = [name for name in FILES if name.endswith(".cl")]
HEADERS = generated_headers()
CONSTANTS = build_constants(Needs(batch=2), FORMS["cpu"])


def mentioned(text: str) -> set[str]:
    return set(re.findall(r"\bFEATURE_(\w+)", text))


def source_of(name: str) -> str:
    """Text of a file or of a generated header; that of the records depends on the program and is empty here."""
    if name.startswith("generated/"):
        return HEADERS.get(name, "")
    return (FOLDER / name).read_text()


# Flattening.


@pytest.mark.parametrize("name", FILES)
def test_every_include_stands_in_the_text_once(name):
    text = flatten(name, HEADERS)
    assert not re.search(r"^\s*#\s*(include|pragma\s+once)", text, re.MULTILINE)
    reached, todo = set(), [name]
    while todo:
        current = todo.pop()
        if current not in reached:
            reached.add(current)
            todo += re.findall(r'#include "(.*?)"', source_of(current))
    assert sorted(re.findall(r'^#line 1 "(.*?)"', text, re.MULTILINE)) == sorted(reached)


@pytest.mark.parametrize("name", FILES)
def test_every_line_says_where_it_is_from(name):
    """Followed by its `#line` directives, the text is the files, line by line."""
    file, number = None, None
    for line in flatten(name, HEADERS).splitlines():
        directive = re.match(r'#line (\d+) "(.*)"', line)
        if directive:
            number, file = int(directive[1]), directive[2]
            continue
        original = source_of(file).splitlines()[number - 1]
        assert line == ("" if original.startswith("#pragma once") else original), f"{file}:{number}"
        number += 1


@pytest.mark.parametrize("name", ["stages/compact.cl", "util/vec.h"])
def test_a_compiler_error_names_file_and_line(name, monkeypatch):
    source = program.kernel_source

    def spoiled(file: str) -> str:
        return source(file) + ("float oops(void) { return no_such_name; }\n" if file == name else "")

    monkeypatch.setattr(program, "kernel_source", spoiled)
    line = source(name).count("\n") + 1
    with pytest.raises(DeviceError, match=rf"{re.escape(name)}\D{{1,3}}{line}\b"):
        Device().build(*stage_source("stages/compact.cl", STRUCTS, CONSTANTS, only(), HEADERS))


def test_a_path_with_spaces(tmp_path, monkeypatch):
    """No path gets to the compiler: the text and the options are the same wherever the package lies."""
    folder = tmp_path / "a folder, with spaces" / "kernels"
    shutil.copytree(FOLDER, folder)
    expected = {name: stage_source(name, STRUCTS, CONSTANTS, all_but(), HEADERS) for name in STAGES}
    program.kernel_source.cache_clear()
    program._program_text.cache_clear()
    monkeypatch.setattr(program.resources, "files", lambda package: folder)
    assert {name: stage_source(name, STRUCTS, CONSTANTS, all_but(), HEADERS) for name in STAGES} == expected
    for text, options in expected.values():
        assert str(FOLDER.parent) not in text + " ".join(options)
        assert not any(option.startswith("-I") for option in options)


# Features.


def test_every_feature_token_is_a_feature():
    tokens = {name: mentioned((FOLDER / name).read_text()) for name in FILES}
    for name, found in tokens.items():
        assert found <= set(FEATURES), name
    # a text mentions a feature, or a kernel is launched only with it
    deciding = {name for kernel in KERNELS.values() for name in kernel.needs}
    assert set().union(*tokens.values()) | deciding == set(FEATURES)


@pytest.mark.parametrize("name", FILES)
def test_features_are_tested_by_value(name):
    """`#ifdef` turns a typo into 'off'; `#if` of a macro that is 0 or 1 does not."""
    for number, line in enumerate((FOLDER / name).read_text().splitlines(), start=1):
        code = line.split("//")[0]
        if "FEATURE_" in code:
            directive = re.match(r"\s*#\s*(\w+)", code)
            assert directive is None or directive[1] in ("if", "elif", "define"), f"{name}:{number}: {line}"
            assert "defined" not in code, f"{name}:{number}: {line}"


def test_a_feature_that_nobody_set_is_an_error():
    with pytest.raises(KeyError, match="BATCH_MEANS"):
        stage_source("stages/reduce.cl", STRUCTS, CONSTANTS, {}, HEADERS)


@pytest.mark.parametrize("name", STAGES)
def test_options_are_the_mentioned_features_alone(name):
    """A feature of another stage must not make this one be compiled anew."""
    text, options = stage_source(name, STRUCTS, CONSTANTS, all_but(), HEADERS)
    assert set(options) == {"-cl-std=CL1.2"} | {f"-DFEATURE_{feature}=1" for feature in mentioned(text)}
    off, options = stage_source(name, STRUCTS, CONSTANTS, only(), HEADERS)
    assert off == text
    assert all(option.endswith("=0") for option in options[1:])


@pytest.fixture(scope="module")
def device():
    return Device()


# Records.


def probe_source(name: str, dtype: np.dtype) -> str:
    """A kernel that writes the size of a record and the offsets of its members, and copies record 1."""
    lines = [f"out[0] = sizeof({name});"]
    lines += [
        f"out[{index}] = (uint)((__private char*)&record.{field} - (__private char*)&record);"
        for index, field in enumerate(dtype.names, start=1)
    ]
    return f"""
    {declare_struct(name, dtype)}
    __kernel void probe_{name}(__global uint* out, __global const {name}* from, __global {name}* to)
    {{
        if (get_global_id(0) != 0) return;
        {name} record = from[1];
        {" ".join(lines)}
        to[1] = record;
    }}
    """


def test_records_have_the_same_layout_on_the_device(device):
    """Size, offsets of all members, and values that are copied to the device and back."""
    source = "".join(probe_source(name, dtype) for name, dtype in STRUCTS.items())
    kernels = device.build(source, ("-cl-std=CL1.2",))
    for name, dtype in STRUCTS.items():
        records = np.arange(2 * dtype.itemsize // 4, dtype=np.uint32).view(dtype)
        out, copy = device.buffer(4 * (len(dtype.names) + 1), "out"), device.buffer(2 * dtype.itemsize, "copy")
        device.launch(kernels[f"probe_{name}"], 1, (out, device.buffer(records, "records"), copy))
        measured = device.read(out, np.uint32, len(dtype.names) + 1).tolist()
        assert measured == [dtype.itemsize, *(dtype.fields[field][1] for field in dtype.names)], name
        copied = device.read(copy, np.uint32, dtype.itemsize // 2)[dtype.itemsize // 4 :]
        assert copied.tolist() == list(range(dtype.itemsize // 4, dtype.itemsize // 2)), name


def test_every_kernel_is_in_the_table():
    found = {(file, kernel) for file in STAGES for kernel in re.findall(r"__kernel void (\w+)\(", source_of(file))}
    assert found == {(row.file, name) for table in (KERNELS, BRUTE_FORCE_KERNELS) for name, row in table.items()}


def test_every_generated_header_is_included():
    included = {name for file in FILES for name in re.findall(r'#include "(generated/.*?)"', source_of(file))}
    headers = {name for name in HEADERS if not name.endswith("_scene_view.h")}  # made for every kernel
    assert headers <= included - {"generated/records.h"} <= set(HEADERS)


# Stages.


@pytest.mark.parametrize("lit", [False, True])
def test_no_shadow_stage_without_lights(monkeypatch, lit):
    """Neither its program nor its buffers."""
    texts, buffers, buffer = [], [], Device.buffer
    monkeypatch.setattr(Device, "build", lambda self, text, options: texts.append(text) or {})  # builds nothing
    monkeypatch.setattr(Device, "buffer", lambda self, size, what: (buffers.append(what), buffer(self, size, what))[1])
    scene = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "film": {"type": "hdrfilm", "width": 2, "height": 2, "rfilter": {"type": "box"}},
        },
        "ball": {"type": "sphere"},
    }
    if lit:
        scene["light"] = {"type": "point", "intensity": 1.0}
    Renderer(scene, strategy="uniform")
    assert any("__kernel void shadow(" in text for text in texts) == lit
    assert ("the shadow rays" in buffers) == lit
    assert "the chunk medians" not in buffers
