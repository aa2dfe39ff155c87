"""Two-sided relay selection and its comparators."""
