"""The emulated plant: its equations, and the kernel that integrates them."""
