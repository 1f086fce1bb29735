//! Cameras, images, lights, light rays and scenes of LumiTokens as plain types.
