"""Commands that measure: taxinet bench ...."""
