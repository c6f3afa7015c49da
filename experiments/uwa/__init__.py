"""UWA: Kalinowski, Drage, Braeunl, Drive-By-Wire for an Autonomous Formula SAE Car."""
