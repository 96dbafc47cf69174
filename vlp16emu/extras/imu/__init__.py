"""An inertial measurement unit beside the sensor."""
