"""The model of motor and instrument that the filter needs: learned from known loads, stored."""
