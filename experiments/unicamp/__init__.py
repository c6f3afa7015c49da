"""Experiments of UNICAMP: Nogueira et al., a miniaturized four-wheel robotic vehicle."""
