"""The simulator replaced by surrogates: candidate effects, libraries, likelihood, fits."""
