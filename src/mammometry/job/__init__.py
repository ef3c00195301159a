"""The method as products that depend on one another, kept between runs."""
