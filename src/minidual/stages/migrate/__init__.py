"""`minidual migrate`: from the simulator to hardware in five gated steps."""
