//! The LumiTokens network: tokenizers, encoder, Scene Token Editor, decoder, heads, checkpoints.
