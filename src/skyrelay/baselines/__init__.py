"""What a learned policy is compared with."""
