"""Text of EDS and DCF files: sections, notation, and the checks of `bowden check eds`."""
