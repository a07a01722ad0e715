"""The model-gap workflow for our own actuator: feature vectors compared through its simulator."""
