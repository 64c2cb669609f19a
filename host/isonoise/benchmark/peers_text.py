"""The ratios to other renderers, for a terminal."""

from collections.abc import Mapping

from isonoise.benchmark.text import lines, spread, table
from isonoise.progress import format_count, format_duration


def peers_text(result: Mapping) -> str:
    """Device and programs, samples per second over Mitsuba's, rays per second over Embree's."""
    device = result["device"]
    parts = [
        lines(
            ("device", f"{device['name']}, {device['compute_units']} compute units"),
            ("driver", f"{device['platform']}, {device['opencl_version']}, driver {device['driver_version']}"),
            ("programs", _programs(result)),
            (
                "figures",
                f"medians of {result['repeat']} turns, in brackets the least and the most; ratios turn by turn",
            ),
        ),
        "",
        _scene_table(result["scenes"]),
    ]
    if any(scene["mitsuba_variant"] != "llvm_ad_rgb" for scene in result["scenes"]):
        parts.append(
            "* by a scalar variant of Mitsuba, which is several times slower: its compiled one found no libLLVM 19 or\n"
            "  newer; install one (Debian: apt install libllvm19) and name it with DRJIT_LIBLLVM_PATH"
        )
    if result["meshes"]:
        parts += ["", _ray_table(result["meshes"])]
    return "\n".join(parts)


def _programs(result: Mapping) -> str:
    variants = ", ".join(sorted({scene["mitsuba_variant"] for scene in result["scenes"]}))
    return (
        f"isonoise {result['isonoise_version']}; Mitsuba {result['mitsuba_version']} ({variants}); "
        f"embreex {result['embreex_version']}, one thread"
    )


def _scene_table(scenes: list[Mapping]) -> str:
    rows = [
        (
            scene["scene"] + ("" if scene["mitsuba_variant"] == "llvm_ad_rgb" else " *"),
            f"{scene['width']}x{scene['height']}, {scene['max_depth']}, {scene['rr_depth']}",
            spread(scene["samples_per_s"], format_count),
            spread(scene["mitsuba_samples_per_s"], format_count),
            spread(scene["ratio"], _ratio),
            "" if scene["image_mean_ratio"] is None else f"{scene['image_mean_ratio']:.4f}",
        )
        for scene in scenes
    ]
    head = ("samples/s", "size, depth, roulette", "isonoise", "Mitsuba", "ratio", "image means")
    return table(head, rows, left=(0, 1))


def _ray_table(meshes: list[Mapping]) -> str:
    rows = [
        (
            mesh["scene"],
            f"{mesh['triangles']:,}",
            row["kind"],
            f"{100 * row['hit_share']:.0f} %",
            spread(row["mrays_per_s"], _ratio),
            spread(row["embree_mrays_per_s"], _ratio),
            spread(row["ratio"], _ratio),
            f"{100 * row['same_triangle_share']:.3f} %",
        )
        for mesh in meshes
        for row in mesh["rays"]
    ]
    head = ("Mrays/s", "triangles", "rays", "hit", "isonoise", "Embree", "ratio", "same triangle")
    builds = ", ".join(
        f"{mesh['scene']} {format_duration(mesh['build_s'])} / {format_duration(mesh['embree_build_s'])}"
        for mesh in meshes
    )
    return f"{table(head, rows, left=(0, 2))}\nhierarchies built in, isonoise / Embree: {builds}"


def _ratio(value: float) -> str:
    return f"{value:.2f}"
