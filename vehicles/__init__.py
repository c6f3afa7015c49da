"""Vehicles: what the nodes believe about a car, one TOML file each."""

from vehicles.vehicle import Vehicle, VehicleError, known_vehicles, load_vehicle, parse_vehicle

__all__ = ["Vehicle", "VehicleError", "known_vehicles", "load_vehicle", "parse_vehicle"]
