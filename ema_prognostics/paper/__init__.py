"""The method of Battipede, Dalla Vedova, Maggiore and Romeo, and its tables repeated."""
