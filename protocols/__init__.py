"""What the experimenter asks for: the YAML schema, the waveforms, the named protocols."""
