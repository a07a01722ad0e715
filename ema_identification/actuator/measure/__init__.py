"""What is measured: the features of a record, its controller, and the same of simulated runs."""
