"""The model-gap workflow: find the disagreement, name the missing effect, show the gap shrink."""
