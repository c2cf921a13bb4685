"""The panel on the right: settings, buttons and number fields, dialogs, keys, help."""
