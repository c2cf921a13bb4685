"""What the measurements share: settings, the machine, the report, a browser that watches."""
