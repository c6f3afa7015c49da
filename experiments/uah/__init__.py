"""UAH: Arango et al., Drive-By-Wire Development Process Based on ROS, Sensors 2020."""
