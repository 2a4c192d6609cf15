"""The part of sl_common that knows ROS: conversions, QoS, parameters, diagnostics, running a node."""
