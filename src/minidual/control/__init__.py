"""Control: joints, grasp matrix, object impedance, grippers and the command arbiter."""
