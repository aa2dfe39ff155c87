// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {SafeERC20} from "@openzeppelin/contracts/token/ERC20/utils/SafeERC20.sol";
import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {EIP712} from "@openzeppelin/contracts/utils/cryptography/EIP712.sol";
import {ISkyRelayExtension} from "../interfaces/ISkyRelayExtension.sol";
import {ISkyRelayTypes} from "../interfaces/ISkyRelayTypes.sol";
import {ISkyRelayPayments} from "./ISkyRelayPayments.sol";

/// @title Payment for what UAVs relay; ISkyRelayPayments says what each function does
/// @dev Money moves between accounts of this contract; the token itself moves with `deposit` and `withdraw` alone.
contract SkyRelayPayments is EIP712, ISkyRelayPayments {
    using SafeERC20 for IERC20;

    bytes32 private constant RECEIPT =
        keccak256("Receipt(address vehicle,address uav,uint32 zone,uint32 period,uint96 amount)");

    ISkyRelayExtension public immutable RELAY;
    IERC20 public immutable TOKEN;
    /// @notice How long a period can last [s].
    uint40 public immutable SERVICE_TIME;
    /// @notice How long a UAV has for its receipts after a period, and how long a withdrawal waits [s].
    uint40 public immutable WINDOW;

    mapping(address member => Account account) private _accounts;
    /// @dev Two for each vehicle: the present period's, and the one before, which may still wait for its receipts.
    mapping(address vehicle => Agreement[2] agreements) private _agreements;

    constructor(address relay, address token, uint40 serviceTime, uint40 window) EIP712("SkyRelayPayments", "1") {
        // Times are bounded so that no deadline overflows.
        if (
            relay.code.length == 0 || token.code.length == 0 || serviceTime == 0 || window == 0
                || serviceTime > 365 days || window > 365 days
        ) revert InvalidTerms();
        RELAY = ISkyRelayExtension(relay);
        TOKEN = IERC20(token);
        SERVICE_TIME = serviceTime;
        WINDOW = window;
    }

    // Deposits

    /// @inheritdoc ISkyRelayPayments
    function deposit(address account, uint96 amount) external {
        if (amount == 0) revert NothingToMove();
        _accounts[account].free += amount;
        emit Deposited(account, msg.sender, amount);
        TOKEN.safeTransferFrom(msg.sender, address(this), amount);
    }

    /// @inheritdoc ISkyRelayPayments
    function requestWithdrawal(uint96 amount) external {
        Account storage account = _accounts[msg.sender];
        if (amount == 0) revert NothingToMove();
        if (amount > account.free) revert InsufficientDeposit(account.free, amount);
        account.free -= amount;
        account.leaving += amount;
        account.leavesAt = _now() + WINDOW;
        emit WithdrawalRequested(msg.sender, account.leaving, account.leavesAt);
    }

    /// @inheritdoc ISkyRelayPayments
    function withdraw() external {
        Account storage account = _accounts[msg.sender];
        uint96 amount = account.leaving;
        if (amount == 0) revert NothingToMove();
        if (_now() < account.leavesAt) revert NotYet(account.leavesAt);
        account.leaving = 0;
        emit Withdrawn(msg.sender, amount);
        TOKEN.safeTransfer(msg.sender, amount);
    }

    // Agreements

    /// @inheritdoc ISkyRelayPayments
    function open() external returns (uint256 opened) {
        uint32 zone = RELAY.getUAVInfo(msg.sender).zone;
        uint32 period = RELAY.getZoneInfo(zone).period;
        ISkyRelayTypes.VehicleSelection[] memory proposals = RELAY.getProposals(msg.sender);
        for (uint256 i = 0; i < proposals.length; ++i) {
            if (proposals[i].status != ISkyRelayTypes.ProposalStatus.Selected) continue;
            address vehicle = proposals[i].vehicle;
            // Terms are frozen while a proposal is selected, so that this is the payment that was proposed.
            // slither-disable-next-line calls-loop (a view of the one contract that it settles for)
            uint96 price = uint96(RELAY.getVehicleInfo(vehicle).payment) * proposals[i].demand;
            if (_open(vehicle, zone, period, price)) ++opened;
        }
    }

    function _open(address vehicle, uint32 zone, uint32 period, uint96 price) private returns (bool) {
        Agreement[2] storage pair = _agreements[vehicle];
        if (_is(pair[0], msg.sender, zone, period) || _is(pair[1], msg.sender, zone, period)) return false;
        Agreement storage free = pair[_isOver(pair[0]) ? 0 : 1];
        if (!_isOver(free)) return false;
        _conclude(vehicle, free);
        Account memory account = _accounts[vehicle];
        if (uint256(account.free) + account.leaving < price) {
            // The mark of an agreement that locks nothing: a second call takes nothing more.
            _write(free, zone, period, 0);
            uint96 forfeited = account.free + account.leaving;
            (account.free, account.leaving) = (0, 0);
            _accounts[vehicle] = account;
            _accounts[msg.sender].free += forfeited;
            emit DepositForfeited(vehicle, msg.sender, zone, period, price, forfeited);
            return false;
        }
        uint96 fromFree = price < account.free ? price : account.free;
        account.free -= fromFree;
        account.leaving -= price - fromFree;
        _accounts[vehicle] = account;
        _write(free, zone, period, price);
        emit AgreementOpened(vehicle, msg.sender, zone, period, price, free.deadline);
        return true;
    }

    function _write(Agreement storage agreement, uint32 zone, uint32 period, uint96 price) private {
        (agreement.uav, agreement.zone, agreement.period) = (msg.sender, zone, period);
        (agreement.locked, agreement.deadline) = (price, _now() + SERVICE_TIME + WINDOW);
        (agreement.claimed, agreement.hasClaimed) = (0, false);
    }

    /// @inheritdoc ISkyRelayPayments
    function settle(Receipt[] calldata receipts) external {
        for (uint256 i = 0; i < receipts.length; ++i) {
            Receipt calldata receipt = receipts[i];
            address vehicle = receipt.vehicle;
            Agreement storage agreement = _agreement(vehicle, msg.sender, receipt.zone, receipt.period);
            uint96 amount = receipt.amount;
            bytes32 hash = receiptHash(vehicle, msg.sender, receipt.zone, receipt.period, amount);
            // slither-disable-next-line unused-return (why a signature is none does not matter)
            (address signer, ECDSA.RecoverError failure,) = ECDSA.tryRecover(hash, receipt.r, receipt.vs);
            if (failure != ECDSA.RecoverError.NoError || signer != vehicle) revert WrongSignature(vehicle);
            if (amount > agreement.locked) revert MoreThanAgreed(amount, agreement.locked);
            uint96 penalty = 0;
            if (agreement.hasClaimed) {
                if (amount > agreement.claimed) penalty = agreement.locked - amount;
                else amount = agreement.claimed;
            }
            _pay(vehicle, agreement, amount, penalty);
        }
    }

    /// @inheritdoc ISkyRelayPayments
    function claim(address uav, uint32 zone, uint32 period, uint96 amount) external {
        Agreement storage agreement = _agreement(msg.sender, uav, zone, period);
        if (agreement.hasClaimed) revert AlreadyClaimed(agreement.claimed);
        if (amount > agreement.locked) revert MoreThanAgreed(amount, agreement.locked);
        uint40 deadline = _now() + WINDOW;
        if (deadline > agreement.deadline) deadline = agreement.deadline;
        (agreement.claimed, agreement.hasClaimed, agreement.deadline) = (amount, true, deadline);
        emit Claimed(msg.sender, uav, zone, period, amount, deadline);
    }

    /// @inheritdoc ISkyRelayPayments
    function close(address[] calldata vehicles) external {
        for (uint256 i = 0; i < vehicles.length; ++i) {
            for (uint256 k = 0; k < 2; ++k) {
                Agreement storage agreement = _agreements[vehicles[i]][k];
                if (_isOver(agreement)) _conclude(vehicles[i], agreement);
            }
        }
    }

    /// @dev Settle one whose time is over; nothing where it is settled.
    function _conclude(address vehicle, Agreement storage agreement) private {
        if (agreement.locked != 0) _pay(vehicle, agreement, agreement.claimed, 0);
    }

    function _pay(address vehicle, Agreement storage agreement, uint96 amount, uint96 penalty) private {
        uint96 rest = agreement.locked - amount - penalty;
        agreement.locked = 0;
        _accounts[agreement.uav].free += amount + penalty;
        if (rest != 0) _accounts[vehicle].free += rest;
        emit Settled(vehicle, agreement.uav, agreement.zone, agreement.period, amount, penalty);
    }

    /// @dev One that takes receipts and claims.
    function _agreement(address vehicle, address uav, uint32 zone, uint32 period)
        private
        view
        returns (Agreement storage)
    {
        Agreement[2] storage pair = _agreements[vehicle];
        Agreement storage found = pair[_is(pair[0], uav, zone, period) ? 0 : 1];
        if (found.locked == 0 || !_is(found, uav, zone, period)) revert NoAgreement(vehicle, uav, zone, period);
        if (_now() > found.deadline) revert Expired(found.deadline);
        return found;
    }

    function _is(Agreement storage agreement, address uav, uint32 zone, uint32 period) private view returns (bool) {
        return agreement.uav == uav && agreement.zone == zone && agreement.period == period;
    }

    function _isOver(Agreement storage agreement) private view returns (bool) {
        return agreement.locked == 0 || _now() > agreement.deadline;
    }

    function _now() private view returns (uint40) {
        return uint40(block.timestamp);
    }

    // Views

    /// @inheritdoc ISkyRelayPayments
    function accountOf(address member) external view returns (Account memory) {
        return _accounts[member];
    }

    /// @inheritdoc ISkyRelayPayments
    function agreementsOf(address vehicle) external view returns (Agreement[2] memory) {
        return _agreements[vehicle];
    }

    /// @inheritdoc ISkyRelayPayments
    function receiptHash(address vehicle, address uav, uint32 zone, uint32 period, uint96 amount)
        public
        view
        returns (bytes32)
    {
        return _hashTypedDataV4(keccak256(abi.encode(RECEIPT, vehicle, uav, zone, period, amount)));
    }
}
