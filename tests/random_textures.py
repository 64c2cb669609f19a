"""Random colours, numbers, textures and image files. Used by scene_generator.py."""

import numpy as np
from random_xml import RandomXml, to_text

TEXTURES = ("bitmap", "bitmap", "checkerboard")


class RandomTextures(RandomXml):
    """Colours, numbers, textures and bitmaps."""

    def colour(self, parent, name: str, low: float, high: float, attribute: str = "", plain: bool = False):
        """A colour, in one of the ways to write it."""
        if not plain and self.chance(0.35):
            self.texture(parent, name, low, high, attribute=attribute)
            return
        values = [self.uniform(low, high) for _ in range(3)]
        way = self.r.choice(("rgb", "rgb", "grey", "flat", "pairs"))
        if way == "rgb":
            self.tag(parent, "rgb", name=name, value=values)
        elif way == "grey":
            self.tag(parent, "rgb", name=name, value=values[0])
        elif way == "flat":
            self.tag(parent, "spectrum", name=name, value=values[0])
        else:
            pairs = zip((380, 520, 640, 800), (*values, values[0]), strict=True)
            self.tag(parent, "spectrum", name=name, value=", ".join(f"{w}:{to_text(v)}" for w, v in pairs))

    def number(self, parent, name: str, low: float, high: float, attribute: str = ""):
        """A parameter that is a number."""
        if self.chance(0.3):
            self.texture(parent, name, low, high, number=True, attribute=attribute)
        else:
            self.float(parent, name, self.uniform(low, high))

    def texture(self, parent, name: str, low, high, number: bool = False, attribute: str = "", kinds=TEXTURES):
        """A texture with values from low to high."""
        is_colour = attribute == "vertex_color"
        if attribute and is_colour != number and self.chance(0.6) and low > 0 and high < 1:
            texture = self.tag(parent, "texture", "mesh_attribute", name=name)
            self.tag(texture, "string", name="name", value=attribute)
            self.float(texture, "scale", self.uniform(0.5, 1.0))
            return
        texture = self.tag(parent, "texture", self.r.choice(kinds), name=name)
        if texture.get("type") == "bitmap":
            encoding = self.r.choice(("png", "bmp", "jpg", "exr", "hdr") if not number else ("png", "exr"))
            size = (self.r.randint(2, 9), self.r.randint(2, 9), 1 if number else 3)
            self.bitmap(texture, self.arrays.uniform(low, min(high, 1.0), size), encoding)
            if number:
                self.tag(texture, "boolean", name="raw", value="true")
            if self.chance(0.5):
                self.tag(texture, "string", name="filter_type", value=self.r.choice(("nearest", "bilinear")))
            if self.chance(0.6):
                self.tag(texture, "string", name="wrap_mode", value=self.r.choice(("repeat", "mirror", "clamp")))
        else:
            for colour in ("color0", "color1"):
                if number:
                    self.float(texture, colour, self.uniform(low, high))
                else:
                    self.colour(texture, colour, low, high, plain=True)
        if self.chance(0.6):
            to_uv = self.tag(texture, "transform", name="to_uv")
            self.tag(to_uv, "scale", x=self.uniform(0.5, 6), y=self.uniform(-4, 4), z=1)
            if self.chance(0.4):
                self.tag(to_uv, "rotate", z=1, angle=self.uniform(0, 360))
            if self.chance(0.4):
                self.tag(to_uv, "translate", x=self.uniform(-1, 1), y=self.uniform(-1, 1))

    def bitmap(self, parent, values: np.ndarray, encoding: str):
        """Writes an image file and its name. 8-bit images hold `values` without a transfer function."""
        path = self.folder / f"{self.name('image')}.{encoding}"
        self.tag(parent, "string", name="filename", value=path.name)
        if encoding == "exr":
            import OpenEXR

            pixels = np.repeat(values, 3 if values.shape[2] == 1 else 1, axis=2).astype(np.float32)
            OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": np.ascontiguousarray(pixels)}).write(str(path))
        elif encoding == "hdr":
            height, width, _ = values.shape
            _, exponent = np.frexp(values.max(axis=2))
            mantissa = values / np.exp2(exponent - 8.0)[..., None]
            rgbe = np.concatenate([mantissa, exponent[..., None] + 128], axis=2).astype(np.uint8)
            head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n"
            path.write_bytes(head.encode() + rgbe.tobytes())
        else:
            from PIL import Image

            pixels = np.rint(255 * values).astype(np.uint8)
            picture = Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels)
            picture.save(path, **({"quality": 95, "subsampling": 0} if encoding == "jpg" else {}))
