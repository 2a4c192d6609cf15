"""The calibration procedures behind the node calibrator: what a sample is, what is missing, what comes out."""
