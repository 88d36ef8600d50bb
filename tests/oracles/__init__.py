"""Independent implementations that the tests and studies compare the product with."""
