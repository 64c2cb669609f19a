"""Output of a render: image files (OpenEXR, PNG) and the error log (CSV)."""
