"""One file per kind of trace; each reads samples as they stand in the file, and judges nothing."""
