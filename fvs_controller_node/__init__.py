"""Control laws, ball prediction and the supervisor that guards every joint command."""
