"""What a loop in real time leaves behind: its recording, its CAN log, and its last seconds before a stop."""
