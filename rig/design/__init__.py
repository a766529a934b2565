"""Design of experiments: protocols that make the error bars of an identification smallest."""
