"""What a run is made of: configuration, settings, folder, tables of experiments."""
