// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {ERC20} from "@openzeppelin/contracts/token/ERC20/ERC20.sol";
import {Ownable} from "@openzeppelin/contracts/access/Ownable.sol";

/// @title Money for a consortium whose chain has none of its own: its owner, a clearing house, issues it
/// @notice One unit is 1e-5 of a currency's unit: what a thousandth of a Mbit/s costs at one cent for a Mbit/s.
contract Credit is ERC20, Ownable {
    constructor() ERC20("SkyRelay credit", "SRC") Ownable(msg.sender) {}

    /// @inheritdoc ERC20
    function decimals() public pure override returns (uint8) {
        return 5;
    }

    /// @notice Credit an account with what it has paid in elsewhere.
    function mint(address account, uint256 amount) external onlyOwner {
        _mint(account, amount);
    }

    /// @notice Give credit back, to be paid out elsewhere.
    function burn(uint256 amount) external {
        _burn(msg.sender, amount);
    }
}
