"""Vehicles: what the nodes believe about a car, one TOML file each."""

from vehicles.reading import DEFAULT, known_vehicles, load_vehicle, parse_vehicle
from vehicles.vehicle import Vehicle, VehicleError

__all__ = ["DEFAULT", "Vehicle", "VehicleError", "known_vehicles", "load_vehicle", "parse_vehicle"]
