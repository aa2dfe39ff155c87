"""Where vehicles are: synthetic models and trace replay."""
