"""One YAML file a sensor model; read by `emulator.spec`."""
