"""Recordings of a real-time loop: MCAP recording, CAN log and flight recording."""
