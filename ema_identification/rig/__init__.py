"""The model-gap workflow for any rig with one axis: regression at its input port."""
