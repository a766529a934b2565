"""Constitutive laws of the walls; model/variants.py registers them."""
