"""Error estimation: the stated error of a render, and the true error against a reference."""
