"""The real drives as logs show them: from torque and motion to the motors' current."""
