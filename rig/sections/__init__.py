"""What the sections of every YAML file are built from: their base class, quantities with units, plug-ins."""
