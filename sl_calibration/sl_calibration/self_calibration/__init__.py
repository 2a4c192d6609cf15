"""Self-calibration: projector, hand-eye transform and all dots from known robot motion, without a calibration grid."""
